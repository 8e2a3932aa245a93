"""Silhouettes (occlusion boundaries) of objects in depth maps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import DepthImage

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

# Minimum relative drop of inverse depth at a silhouette, and distance in pixels within which the background
# is searched. Sensors often measure nothing right next to an object.
_MIN_DROP_RATIO, _SEARCH_RADIUS_PX = 0.08, 16
# Blur of the foreground mask that smooths silhouette normals, pixels; minimum slope of the blurred mask.
_BLUR_PX, _MIN_SLOPE = 1.5, 0.15
# Number of pixels inwards that must belong to the object, and maximum relative change of their inverse depth.
_INSIDE_PX, _MAX_CHANGE_RATIO = 4, 0.03
# Minimum extent of a silhouette, pixels; shorter ones are noise.
_MIN_LENGTH_PX = 15


class Silhouettes(NamedTuple):
    """Points on the silhouettes of a depth map.

    Attributes
    ----------
    pixels : (n, 2) float32, x and y of the boundary.
    normals : (n, 2) float32 unit normals, away from the object.
    depths : (n,) float32 depth of the object, metres.
    """

    pixels: Image
    normals: Image
    depths: Image


def detect_silhouettes(depth: DepthImage) -> Silhouettes:
    """Detect silhouettes of objects in front of measured background.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    """
    import cv2

    inverse = _fill_gaps(depth)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _SEARCH_RADIUS_PX + 1,) * 2)
    nearest = np.asarray(cv2.dilate(inverse, disc), np.float32)
    known = np.where(inverse > 0, inverse, np.float32(np.inf))
    # Clipped, because `known` is infinite without depth; missing depth is no jump.
    farthest = np.minimum(np.asarray(cv2.erode(known, disc), np.float32), nearest)
    is_near = inverse > (nearest + farthest) / 2
    torn = nearest > farthest * np.float32(1 + _MIN_DROP_RATIO)
    blurred = cv2.GaussianBlur(is_near.astype(np.float32), (0, 0), _BLUR_PX)
    across, down = (
        np.asarray(-cv2.Sobel(blurred, cv2.CV_32F, *axis), np.float32) for axis in ((1, 0), (0, 1))
    )
    slope = np.asarray(np.hypot(across, down), np.float32)
    inner = np.asarray(cv2.erode(is_near.astype(np.uint8), np.ones((3, 3), np.uint8))) > 0
    rows, columns = np.nonzero(_drop_short_outlines(is_near & torn & ~inner & (slope > _MIN_SLOPE)))
    outwards = np.stack([across[rows, columns], down[rows, columns]], axis=1) / slope[rows, columns, None]
    sound = _find_occluding_points(inverse, rows, columns, outwards)
    rows, columns, outwards = rows[sound], columns[sound], outwards[sound]
    ends = np.stack([columns, rows], axis=1).astype(np.float32) + outwards / np.float32(2)
    return Silhouettes(ends, outwards, np.reciprocal(inverse[rows, columns]))


def _fill_gaps(depth: DepthImage) -> Image:
    """Compute inverse depth with small gaps filled.

    Depth maps reprojected to another camera have a lattice of gaps.
    """
    import cv2

    known = depth > 0
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=known)
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    values = np.zeros(int(nearest.max()) + 1, np.float32)
    values[nearest[known]] = inverse[known]
    # Gaps are only filled between measured pixels; elsewhere, objects would grow into areas that they
    # occlude.
    between = cv2.morphologyEx(known.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0
    filled = np.where(between, values[nearest], np.float32(0))
    return np.asarray(cv2.medianBlur(filled, 3), np.float32)


def _drop_short_outlines(outlines_mask: Mask) -> Mask:
    import cv2

    joined = cv2.dilate(outlines_mask.astype(np.uint8), np.ones((3, 3), np.uint8))
    _, label, boxes, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    sides = np.maximum(boxes[:, cv2.CC_STAT_WIDTH], boxes[:, cv2.CC_STAT_HEIGHT])
    return np.asarray(outlines_mask & (sides >= _MIN_LENGTH_PX)[label])


def _find_occluding_points(inverse: Image, rows: Indices, columns: Indices, normals: Image) -> Mask:
    """Check which boundary points have the object inwards and background outwards.

    Returns a mask (n,). The background must come before any other surface as near as the object.
    """
    height, width = inverse.shape
    own = inverse[rows, columns]

    def sample_at_step(step: int) -> Image:
        y = np.clip(np.rint(rows + step * normals[:, 1]).astype(np.intp), 0, height - 1)
        x = np.clip(np.rint(columns + step * normals[:, 0]).astype(np.intp), 0, width - 1)
        return np.asarray(inverse[y, x])

    sound = np.ones(len(rows), bool)
    for step in range(1, _INSIDE_PX + 1):
        sound &= np.abs(sample_at_step(-step) - own) < _MAX_CHANGE_RATIO * own
    found, hidden = np.zeros_like(sound), np.zeros_like(sound)
    for step in range(1, _SEARCH_RADIUS_PX + 1):
        outer = sample_at_step(step)
        found |= (outer > 0) & (outer * (1 + _MIN_DROP_RATIO) < own) & ~hidden
        # The pixel next to the boundary may still belong to the object.
        hidden |= (outer * (1 + _MIN_DROP_RATIO / 2) >= own) & (step > 1)
    return sound & found
