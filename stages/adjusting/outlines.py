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
_JUMP, _REACH = 0.08, 16
# Blur of the foreground mask that smooths silhouette normals, pixels; minimum slope of the blurred mask.
_BLUR, _LEAST_SLOPE = 1.5, 0.15
# Number of pixels inwards that must belong to the object, and maximum relative change of their inverse depth.
_INSIDE, _SAME = 4, 0.03
# Minimum extent of a silhouette, pixels; shorter ones are noise.
_LEAST_LENGTH = 15


class Outlines(NamedTuple):
    """Points on the silhouettes of a depth map.

    Attributes
    ----------
    pixels : (n, 2) float32, x and y of the boundary.
    outwards : (n, 2) float32 unit normals, away from the object.
    depths : (n,) float32 depth of the object, metres.
    """

    pixels: Image
    outwards: Image
    depths: Image


def outlines(depth: DepthImage) -> Outlines:
    """Detect silhouettes of objects in front of measured background.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    """
    import cv2

    inverse = _without_gaps(depth)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _REACH + 1,) * 2)
    nearest = np.asarray(cv2.dilate(inverse, disc), np.float32)
    known = np.where(inverse > 0, inverse, np.float32(np.inf))
    # Clipped, because `known` is infinite without depth; missing depth is no jump.
    farthest = np.minimum(np.asarray(cv2.erode(known, disc), np.float32), nearest)
    is_near = inverse > (nearest + farthest) / 2
    torn = nearest > farthest * np.float32(1 + _JUMP)
    blurred = cv2.GaussianBlur(is_near.astype(np.float32), (0, 0), _BLUR)
    across, down = (
        np.asarray(-cv2.Sobel(blurred, cv2.CV_32F, *axis), np.float32) for axis in ((1, 0), (0, 1))
    )
    slope = np.asarray(np.hypot(across, down), np.float32)
    inner = np.asarray(cv2.erode(is_near.astype(np.uint8), np.ones((3, 3), np.uint8))) > 0
    rows, columns = np.nonzero(_long(is_near & torn & ~inner & (slope > _LEAST_SLOPE)))
    outwards = np.stack([across[rows, columns], down[rows, columns]], axis=1) / slope[rows, columns, None]
    sound = _ends_before_another(inverse, rows, columns, outwards)
    rows, columns, outwards = rows[sound], columns[sound], outwards[sound]
    ends = np.stack([columns, rows], axis=1).astype(np.float32) + outwards / np.float32(2)
    return Outlines(ends, outwards, np.reciprocal(inverse[rows, columns]))


def _without_gaps(depth: DepthImage) -> Image:
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


def _long(ends: Mask) -> Mask:
    import cv2

    joined = cv2.dilate(ends.astype(np.uint8), np.ones((3, 3), np.uint8))
    _, label, boxes, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    sides = np.maximum(boxes[:, cv2.CC_STAT_WIDTH], boxes[:, cv2.CC_STAT_HEIGHT])
    return np.asarray(ends & (sides >= _LEAST_LENGTH)[label])


def _ends_before_another(inverse: Image, rows: Indices, columns: Indices, outwards: Image) -> Mask:
    """Check which boundary points have the object inwards and background outwards.

    Returns a mask (n,). The background must come before any other surface as near as the object.
    """
    height, width = inverse.shape
    own = inverse[rows, columns]

    def beside(step: int) -> Image:
        y = np.clip(np.rint(rows + step * outwards[:, 1]).astype(np.intp), 0, height - 1)
        x = np.clip(np.rint(columns + step * outwards[:, 0]).astype(np.intp), 0, width - 1)
        return np.asarray(inverse[y, x])

    sound = np.ones(len(rows), bool)
    for step in range(1, _INSIDE + 1):
        sound &= np.abs(beside(-step) - own) < _SAME * own
    found, hidden = np.zeros_like(sound), np.zeros_like(sound)
    for step in range(1, _REACH + 1):
        outer = beside(step)
        found |= (outer > 0) & (outer * (1 + _JUMP) < own) & ~hidden
        # The pixel next to the boundary may still belong to the object.
        hidden |= (outer * (1 + _JUMP / 2) >= own) & (step > 1)
    return sound & found
