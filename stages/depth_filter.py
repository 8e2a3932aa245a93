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

# Differences are averaged over this many pixels each way: enough to even out the depth steps of a
# structured-light sensor, few enough to keep a table's edge.
_WINDOW = 5


@dataclass(frozen=True, eq=False)
class Surface:
    """A depth map with the orientation of the surface at each pixel.

    Attributes
    ----------
    depth : (h, w) float32 metres, 0 where missing or filtered away.
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
    where nothing is; so both sides of it go.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    max_jump : change of depth between neighbouring pixels, relative to depth, that makes a discontinuity.
    max_angle : degrees between the line of sight and the surface's normal.
    """
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    torn = np.zeros(depth.shape, bool)
    columns, rows, ray_length = _rays(camera)
    # d ln z = −z d(1/z)
    across = -depth * _mean_difference(inverse, 1, max_jump, torn)
    down = -depth * _mean_difference(inverse, 0, max_jump, torn)
    x = np.float32(camera.fx) * across
    y = np.float32(camera.fy) * down
    z = -(1 + columns * x + rows * y)
    obliqueness = np.sqrt(x * x + y * y + z * z)
    too_oblique = obliqueness * ray_length * np.float32(np.cos(np.radians(max_angle))) > 1
    return Surface(np.where(torn | too_oblique, np.float32(0), depth), (x, y, z), obliqueness)


def _mean_difference(inverse: Image, axis: int, max_jump: float, torn: Mask) -> Image:
    """Mean difference of neighbours along `axis` in a window; discontinuities are left out and marked torn."""
    import cv2

    first: tuple[slice, slice] = (slice(None), slice(None, -1)) if axis else (slice(None, -1), slice(None))
    second: tuple[slice, slice] = (slice(None), slice(1, None)) if axis else (slice(1, None), slice(None))
    a, b = inverse[first], inverse[second]
    difference = b - a
    nearer_far = np.minimum(a, b)
    jump = np.abs(difference) > np.float32(max_jump) * nearer_far
    both = nearer_far > 0
    torn_here = jump & both
    torn[first] |= torn_here
    torn[second] |= torn_here
    good = np.zeros(inverse.shape, np.float32)
    good[first] = both & ~jump
    total = np.zeros(inverse.shape, np.float32)
    np.multiply(difference, good[first], out=total[first])
    window = (_WINDOW, _WINDOW)
    total = cv2.boxFilter(total, -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    count = cv2.boxFilter(good, -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total / np.maximum(count, 1), np.float32)


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> tuple[Image, Image, Image]:
    """x/z of each column (w,), y/z of each row (h, 1), and the ray's length (h, w)."""
    columns = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    rows = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)[:, None]
    return columns, rows, np.sqrt(1 + columns**2 + rows**2)
