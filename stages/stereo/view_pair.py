"""Two posed views as a rectified pair, and depth back from it into the first view.

The rectified cameras' x axis is the line from one view to the other, whichever way that runs in the images
(Fusiello, Trucco and Verri, "A compact algorithm for rectification of stereo pairs", 2000). Views above
each other, or turned about their axes, then need no care of their own. The rectified images hold what
the first view shows, at its own scale; OpenCV's stereoRectify would crop or shrink turned ones.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import Camera, DepthImage
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.rectify import RectifiedRig

# Rays more oblique than this to the rectified axis (cosine) would stretch the image, and are left out; where
# that is half of them, the views stand one behind the other.
_LEAST_COSINE = 0.5
# Nor may the rectified images, with the room for disparity beside them, be larger than so many views.
_LARGEST_AREA = 6
_LARGEST_SIDE = 1 << 14
# Rays that are looked at: so many a row and a column.
_GRID = 17
# A position beyond every rectified image.
_OUTSIDE = 2.0 * _LARGEST_SIDE
# Inverse depth is interpolated between pixels of one surface only, not across a jump of more than this share.
_JUMP = 0.01


def rectified_views(first: PosedView, second: PosedView) -> tuple[RectifiedRig, float, float] | None:
    """Return the rig of two views, the first on the left, with the range of depth in its axes.

    Returns
    -------
    The rig, and the nearest and farthest depth of the first view's range, metres along the rectified axis;
    None where no common rows can be had, because one view stands in front of the other.
    """
    import cv2

    across = second.centre - first.centre
    baseline = float(np.linalg.norm(across))
    if baseline == 0:
        return None
    x = across / baseline
    ahead = first.world_from_camera[:3, 2] + second.world_from_camera[:3, 2]
    z = ahead - (ahead @ x) * x
    if np.linalg.norm(z) < _LEAST_COSINE:
        return None
    z /= np.linalg.norm(z)
    rectified_from_world = np.stack([x, np.cross(z, x), z])
    turns = [rectified_from_world @ view.world_from_camera[:3, :3] for view in (first, second)]
    rays = first.spread_rays(_GRID) @ turns[0].T
    straight = rays[:, 2] >= _LEAST_COSINE * np.linalg.norm(rays, axis=1)
    if np.count_nonzero(straight) < len(rays) / 2:
        return None
    rays = rays[straight]
    near, far = float((rays[:, 2] * first.near).min()), float((rays[:, 2] * first.far).max())
    focal = math.sqrt(first.camera.fx * first.camera.fy)
    least, most = focal * baseline / far, focal * baseline / near
    low, high = (np.round(f(focal * rays[:, :2] / rays[:, 2:], axis=0)) for f in (np.min, np.max))
    # What is near lies farther left in the second image, by up to this much: room for it on that side.
    room = math.ceil(most - least)
    width, height = int(high[0] - low[0]) + 1 + room, int(high[1] - low[1]) + 1
    if width * height > _LARGEST_AREA * first.camera.width * first.camera.height:
        return None
    if max(width, height) > _LARGEST_SIDE:
        return None
    left = Camera(width, height, focal, focal, room - float(low[0]), -float(low[1]))
    right = Camera(width, height, focal, focal, left.cx + math.floor(least), left.cy)
    maps = tuple(
        cv2.initUndistortRectifyMap(
            view.camera.matrix, np.zeros(4), turn, camera.matrix, (width, height), cv2.CV_16SC2
        )
        for view, turn, camera in zip((first, second), turns, (left, right), strict=True)
    )
    return RectifiedRig(left, right, baseline, turns[0], (maps[0], maps[1])), near, far


def depth_in_view(
    depth: DepthImage, confidence: NDArray[np.uint8], rig: RectifiedRig, first: PosedView, second: PosedView
) -> tuple[DepthImage, NDArray[np.uint8]]:
    """Return depth along the first view's own axis at each of its pixels, and its confidence.

    Both cameras stand in one place, so that each pixel of the view has one place in the rectified map.

    Parameters
    ----------
    depth, confidence : (h, w) of the rectified left image; depth in metres, 0 where there is none.

    Returns
    -------
    (h, w) float32 metres, 0 where there is none, or where the second view does not see the place; and
    (h, w) uint8, the confidence.
    """
    import cv2

    camera = first.camera
    columns, rows = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    rays = first.rays(columns, rows)
    turned = rays @ rig.rectified_from_left.T
    ahead = np.where(turned[..., 2] > 0, turned[..., 2], np.nan)
    # What the rectified map does not hold lies outside it: -1.
    across, down = (
        np.nan_to_num(turned[..., axis] / ahead * focal + centre, nan=-1)
        .clip(-1, _OUTSIDE)
        .astype(np.float32)
        for axis, focal, centre in ((0, rig.left.fx, rig.left.cx), (1, rig.left.fy, rig.left.cy))
    )
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    nearest = cv2.remap(inverse, across, down, cv2.INTER_NEAREST)
    between = cv2.remap(inverse, across, down, cv2.INTER_LINEAR)
    # A missing neighbour counts as 0 and shows as a jump.
    smooth = np.abs(between - nearest) <= _JUMP * nearest
    inverse = np.where(smooth, between, nearest)
    found = inverse > 0
    z = np.divide(1, inverse * turned[..., 2], out=np.zeros(inverse.shape), where=found)
    u, v, _ = second.project(first.to_world(rays * z[..., None]))
    z[~(found & second.holds(u, v))] = 0
    trust = np.asarray(cv2.remap(confidence, across, down, cv2.INTER_NEAREST), np.uint8)
    return z.astype(np.float32), np.where(z > 0, trust, np.uint8(0))
