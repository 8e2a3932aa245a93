"""What a depth map says about the surface it shows: how obliquely it is seen, and where it is torn.

Differences are taken on inverse depth. A plane's inverse depth is linear in the pixel coordinates, so
that averaging its differences over a window is exact on planes, however obliquely they are seen;
differences of depth itself are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stages.scan import Camera, DepthImage

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Pixels more oblique than this (80 degrees) must come in areas of at least `_AREA` pixels each way, as a road
# does. In a thin line they are a discontinuity that the sensor or the matcher has smeared.
_STEEP = 6.0
_AREA = 5
# Differences are averaged over this many pixels each way: enough to even out the depth steps of a
# structured-light sensor, few enough to keep a table's edge.
_WINDOW = 5


@dataclass(frozen=True, eq=False)
class Surface:
    """A depth map with the orientation of the surface at each pixel.

    Attributes
    ----------
    depth : (h, w) float32 metres, 0 where missing or dropped.
    normal : three (h, w) float32 images, the surface's normal in camera axes, towards the camera, scaled
        so that its product with the pixel's ray (x/z, y/z, 1) is −1.
    obliqueness : (h, w) float32 ≥ about 1, the length of `normal`: how many metres along the optical axis
        it takes to get one metre away from the surface.
    """

    depth: DepthImage
    normal: tuple[Image, Image, Image]
    obliqueness: Image


def surface(depth: DepthImage, camera: Camera, *, max_jump: float, max_angle: float) -> Surface:
    """Measure the surface's orientation, and drop pixels at depth discontinuities or seen too obliquely.

    Sensors and matchers put "flying" pixels beside a discontinuity, between the near and the far surface,
    where nothing is; so both sides of it go. Gaps of one pixel between depths that agree are bridged: depth
    that was warped into a colour camera's view is full of them.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    max_jump : change of depth between neighbouring pixels, relative to depth, that makes a discontinuity.
    max_angle : degrees between the line of sight and the surface's normal.
    """
    import cv2

    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    depth = depth.copy()
    for axis in (1, 0):
        _bridge(depth, inverse, axis, max_jump)
    torn = np.zeros(depth.shape, bool)
    columns, rows, ray_length = _rays(camera)
    # d ln z = −z d(1/z)
    x = np.float32(-camera.fx) * depth * _mean_difference(inverse, 1, max_jump, torn)
    y = np.float32(-camera.fy) * depth * _mean_difference(inverse, 0, max_jump, torn)
    z = -(1 + columns * x + rows * y)
    obliqueness = np.sqrt(x * x + y * y + z * z)
    steep = (obliqueness > _STEEP).astype(np.uint8)
    smeared = steep > cv2.morphologyEx(steep, cv2.MORPH_OPEN, np.ones((_AREA, _AREA), np.uint8))
    too_oblique = obliqueness * ray_length * np.float32(np.cos(np.radians(max_angle))) > 1
    depth[torn | smeared | too_oblique] = 0
    return Surface(depth, (x, y, z), obliqueness)


def _bridge(depth: DepthImage, inverse: Image, axis: int, max_jump: float) -> None:
    """Fill single missing pixels between two of like depth, in place."""
    # Views along the columns, whichever the axis, so that one set of slices serves both.
    inverse, depth = (inverse, depth) if axis else (inverse.T, depth.T)
    before, after = inverse[:, :-2], inverse[:, 2:]
    rows, columns = np.nonzero((inverse[:, 1:-1] == 0) & (np.minimum(before, after) > 0))
    a, b = before[rows, columns], after[rows, columns]
    agree = np.abs(a - b) <= np.float32(max_jump) * np.minimum(a, b)
    rows, columns, middle = rows[agree], columns[agree] + 1, (a + b)[agree] / 2
    inverse[rows, columns] = middle
    depth[rows, columns] = 1 / middle


def _mean_difference(inverse: Image, axis: int, max_jump: float, torn: Mask) -> Image:
    """Mean difference of neighbours along `axis`, in a window; discontinuities are left out, and marked."""
    import cv2

    first, second = (np.s_[:, :-1], np.s_[:, 1:]) if axis else (np.s_[:-1, :], np.s_[1:, :])
    a, b = inverse[first], inverse[second]
    difference = b - a
    smaller = np.minimum(a, b)
    both = smaller > 0
    jump = both & (np.abs(difference) > np.float32(max_jump) * smaller)
    torn[first] |= jump
    torn[second] |= jump
    good = np.zeros(inverse.shape, np.float32)
    good[first] = both & ~jump
    kept = np.zeros(inverse.shape, np.float32)
    np.multiply(difference, good[first], out=kept[first])
    window = (_WINDOW, _WINDOW)
    total = cv2.boxFilter(kept, -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    count = cv2.boxFilter(good, -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total / np.maximum(count, 1), np.float32)


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> tuple[Image, Image, Image]:
    """x/z of each column (w,), y/z of each row (h, 1), and the ray's length (h, w)."""
    columns = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    rows = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)[:, None]
    return columns, rows, np.sqrt(1 + columns**2 + rows**2)
