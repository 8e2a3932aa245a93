"""Rectification of two posed views, and depth transfer back.

The x axis of the rectified cameras is the baseline, in any direction (Fusiello, Trucco and Verri, "A compact
algorithm for rectification of stereo pairs", 2000). Vertical or rotated arrangements therefore need no
special treatment. The rectified images contain the whole first view at its own scale. OpenCV's stereoRectify
would crop or shrink rotated views.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import Camera, DepthImage
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.rectify import RectifiedRig

# Minimum cosine between a ray and the rectified axis; more oblique rays would stretch the image, and are
# dropped. If half of the rays are, one view is behind the other.
_MIN_COSINE = 0.5
# Maximum size of the rectified images, including the margin for disparity: area relative to the view, and
# side in px.
_MAX_AREA_RATIO = 6
_MAX_SIDE_PX = 1 << 14
# Grid of sampled rays, per side.
_GRID_SIZE = 17
# Coordinate outside of every rectified image.
_OUTSIDE = 2.0 * _MAX_SIDE_PX
# Maximum relative jump of inverse depth across which it is interpolated.
_MAX_JUMP_RATIO = 0.01


def rectify_views(first: PosedView, second: PosedView) -> tuple[RectifiedRig, float, float] | None:
    """Rectify two views, with the first one on the left.

    Returns
    -------
    The rig, and minimum and maximum depth of the first view's range along the rectified axis, metres. None if
    the views cannot be rectified, because one is in front of the other.
    """
    import cv2

    across = second.centre - first.centre
    baseline = float(np.linalg.norm(across))
    if baseline == 0:
        return None
    x = across / baseline
    ahead = first.world_from_camera[:3, 2] + second.world_from_camera[:3, 2]
    z = ahead - (ahead @ x) * x
    if np.linalg.norm(z) < _MIN_COSINE:
        return None
    z /= np.linalg.norm(z)
    rectified_from_world = np.stack([x, np.cross(z, x), z])
    rotations = [rectified_from_world @ view.world_from_camera[:3, :3] for view in (first, second)]
    rays = first.compute_ray_grid(_GRID_SIZE) @ rotations[0].T
    is_valid = rays[:, 2] >= _MIN_COSINE * np.linalg.norm(rays, axis=1)
    if np.count_nonzero(is_valid) < len(rays) / 2:
        return None
    rays = rays[is_valid]
    near, far = float((rays[:, 2] * first.near).min()), float((rays[:, 2] * first.far).max())
    focal = math.sqrt(first.camera.fx * first.camera.fy)
    min_disparity, max_disparity = focal * baseline / far, focal * baseline / near
    low, high = (np.round(f(focal * rays[:, :2] / rays[:, 2:], axis=0)) for f in (np.min, np.max))
    # Near points are farther left in the second image by up to this disparity, so that the image gets a
    # margin there.
    disparity_margin = math.ceil(max_disparity - min_disparity)
    width, height = int(high[0] - low[0]) + 1 + disparity_margin, int(high[1] - low[1]) + 1
    if width * height > _MAX_AREA_RATIO * first.camera.width * first.camera.height:
        return None
    if max(width, height) > _MAX_SIDE_PX:
        return None
    left = Camera(width, height, focal, focal, disparity_margin - float(low[0]), -float(low[1]))
    right = Camera(width, height, focal, focal, left.cx + math.floor(min_disparity), left.cy)
    maps = tuple(
        cv2.initUndistortRectifyMap(
            view.camera.matrix, np.zeros(4), turn, camera.matrix, (width, height), cv2.CV_16SC2
        )
        for view, turn, camera in zip((first, second), rotations, (left, right), strict=True)
    )
    return RectifiedRig(left, right, baseline, rotations[0], (maps[0], maps[1])), near, far


def transfer_depth(
    depth: DepthImage, confidence: NDArray[np.uint8], rig: RectifiedRig, first: PosedView, second: PosedView
) -> tuple[DepthImage, NDArray[np.uint8]]:
    """Transfer depth from the rectified to the first view.

    Both cameras have the same centre, so that each pixel of the view has one position in the rectified map.

    Parameters
    ----------
    depth, confidence : (h, w) of the rectified left image; depth in metres, 0 where missing.

    Returns
    -------
    Depth along the first view's axis, (h, w) float32 metres, 0 where missing or outside of the second view;
    and confidence, (h, w) uint8.
    """
    import cv2

    camera = first.camera
    columns, rows = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    rays = first.compute_rays(columns, rows)
    rectified_rays = rays @ rig.rectified_from_left.T
    ahead = np.where(rectified_rays[..., 2] > 0, rectified_rays[..., 2], np.nan)
    # Rays outside of the rectified map get the coordinate -1.
    across, down = (
        np.nan_to_num(rectified_rays[..., axis] / ahead * focal + centre, nan=-1)
        .clip(-1, _OUTSIDE)
        .astype(np.float32)
        for axis, focal, centre in ((0, rig.left.fx, rig.left.cx), (1, rig.left.fy, rig.left.cy))
    )
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    nearest = cv2.remap(inverse, across, down, cv2.INTER_NEAREST)
    between = cv2.remap(inverse, across, down, cv2.INTER_LINEAR)
    # Missing neighbours are 0, and therefore count as a jump.
    smooth = np.abs(between - nearest) <= _MAX_JUMP_RATIO * nearest
    inverse = np.where(smooth, between, nearest)
    found = inverse > 0
    z = np.divide(1, inverse * rectified_rays[..., 2], out=np.zeros(inverse.shape), where=found)
    u, v, _ = second.project(first.to_world(rays * z[..., None]))
    z[~(found & second.contains(u, v))] = 0
    view_confidence = np.asarray(cv2.remap(confidence, across, down, cv2.INTER_NEAREST), np.uint8)
    return z.astype(np.float32), np.where(z > 0, view_confidence, np.uint8(0))
