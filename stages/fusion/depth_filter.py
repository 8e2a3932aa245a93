"""What a depth map says about the surface it shows: how obliquely it is seen, and where it is torn.

Differences are taken on inverse depth. A plane's inverse depth is linear in the pixel coordinates, so
that averaging its differences over a window is exact on planes, however obliquely they are seen;
differences of depth itself are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.scans.scan import Camera, DepthImage

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


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


def surface(
    depth: DepthImage,
    camera: Camera,
    *,
    max_jump: float,
    max_angle: float,
    min_depth: float = 0.0,
    max_depth: float = math.inf,
) -> Surface:
    """Measure the surface's orientation, and drop pixels at depth discontinuities or seen too obliquely.

    Sensors and matchers put "flying" pixels beside a discontinuity, between the near and the far surface,
    where nothing is; so both sides of it go. Gaps of one pixel between depths that agree are bridged: depth
    that was warped into a colour camera's view is full of them.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    max_jump : change of depth between neighbouring pixels, relative to depth, that makes a discontinuity.
    max_angle : degrees between the line of sight and the surface's normal.
    min_depth, max_depth : metres; what is nearer or farther is missing.
    """
    filtered, normal, obliqueness = _kernels.oriented_depth(
        np.ascontiguousarray(depth, np.float32),
        (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height),
        limits=(min_depth, max_depth, max_jump, math.cos(math.radians(max_angle))),
        # Frames are read side by side.
        wanted_threads=1,
    )
    return Surface(filtered, normal, obliqueness)


def bridged(depth: DepthImage, max_jump: float) -> tuple[DepthImage, Image]:
    """Return depth without gaps of one pixel between depths that agree, and its inverse; see `surface`."""
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    depth = depth.copy()
    for axis in (1, 0):
        _bridge(depth, inverse, axis, max_jump)
    return depth, inverse


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


@dataclass(frozen=True, eq=False)
class Differences:
    """Differences between neighbouring pixels along an axis, and 1 where there is one, else 0."""

    value: Image
    known: Image

    def mean(self, window: int, at: Any = ...) -> Image:
        """Mean of the known differences in a window around each pixel, or around those that `at` indexes."""
        import cv2

        total, count = (
            cv2.boxFilter(image, -1, (window, window), normalize=False, borderType=cv2.BORDER_CONSTANT)
            for image in (self.value, self.known)
        )
        return np.asarray(total[at] / np.maximum(count[at], 1))


def differences(inverse: Image, axis: int, max_jump: float, torn: Mask) -> Differences:
    """Take differences along `axis`; discontinuities are left out, and marked in `torn`."""
    first, second = (np.s_[:, :-1], np.s_[:, 1:]) if axis else (np.s_[:-1, :], np.s_[1:, :])
    a, b = inverse[first], inverse[second]
    difference = b - a
    smaller = np.minimum(a, b)
    both = smaller > 0
    jump = both & (np.abs(difference) > np.float32(max_jump) * smaller)
    torn[first] |= jump
    torn[second] |= jump
    value, known = np.zeros(inverse.shape, np.float32), np.zeros(inverse.shape, np.float32)
    known[first] = both & ~jump
    np.multiply(difference, known[first], out=value[first])
    return Differences(value, known)
