"""Filter of depth maps: surface normals, depth discontinuities and grazing angles.

Differences are taken of inverse depth. The inverse depth of a plane is linear in the pixel coordinates.
Averaging its differences over a window is therefore exact on planes at any angle. Averaging differences of
depth is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.scan import Camera, DepthImage

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class OrientedDepth:
    """Depth map with the orientation of the surface at each pixel.

    Attributes
    ----------
    depth : (h, w) float32 metres, 0 where missing or dropped.
    normal : three (h, w) float32 images: the surface normal in camera axes, towards the camera. The normal is
        scaled so that its product with the pixel's ray (x/z, y/z, 1) is −1.
    obliqueness : (h, w) float32, about 1 or more: length of `normal`. This is the ratio of the depth to the
        distance between camera and tangent plane.
    """

    depth: DepthImage
    normal: tuple[Image, Image, Image]
    obliqueness: Image


def orient_depth(
    depth: DepthImage,
    camera: Camera,
    *,
    max_jump: float,
    max_angle: float,
    min_depth: float = 0.0,
    max_depth: float = math.inf,
) -> OrientedDepth:
    """Measure surface normals, and drop pixels at discontinuities and grazing angles.

    Sensors and matchers put "flying" pixels next to a discontinuity, between the near and the far surface.
    Both sides of a discontinuity are therefore dropped. Depth maps reprojected to a colour camera have many
    gaps of one pixel. Such gaps are bridged if the depths on both sides agree.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    camera : pinhole camera of the depth map.
    max_jump : maximum relative change of depth between neighbouring pixels; more is a discontinuity.
    max_angle : maximum angle between the line of sight and the surface normal, degrees.
    min_depth, max_depth : metres; nearer and farther depth is dropped.
    """
    filtered, normal, obliqueness = _kernels.filter_depth(
        np.ascontiguousarray(depth, np.float32),
        (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height),
        limits=(min_depth, max_depth, max_jump, math.cos(math.radians(max_angle))),
        # Frames are read in parallel.
        wanted_threads=1,
    )
    return OrientedDepth(filtered, normal, obliqueness)


def fill_gaps(depth: DepthImage, max_jump: float) -> tuple[DepthImage, Image]:
    """Bridge gaps of one pixel between depths that agree.

    Returns depth and inverse depth (h, w); 0 where missing.
    """
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    depth = depth.copy()
    for axis in (1, 0):
        _fill_gaps_along(depth, inverse, axis, max_jump)
    return depth, inverse


def _fill_gaps_along(depth: DepthImage, inverse: Image, axis: int, max_jump: float) -> None:
    """Fill single missing pixels between similar depths, in place."""
    # Transposed views let the same slices serve both axes.
    inverse, depth = (inverse, depth) if axis else (inverse.T, depth.T)
    before, after = inverse[:, :-2], inverse[:, 2:]
    rows, columns = np.nonzero((inverse[:, 1:-1] == 0) & (np.minimum(before, after) > 0))
    a, b = before[rows, columns], after[rows, columns]
    agree = np.abs(a - b) <= np.float32(max_jump) * np.minimum(a, b)
    rows, columns, middle = rows[agree], columns[agree] + 1, (a + b)[agree] / 2
    inverse[rows, columns] = middle
    depth[rows, columns] = 1 / middle


@dataclass(frozen=True, eq=False)
class PixelDifferences:
    """Differences between neighbouring pixels along an axis.

    Attributes
    ----------
    value : (h, w) float32 difference to the next pixel, 0 where unknown.
    known : (h, w) float32, 1 where the difference is known, else 0.
    """

    value: Image
    known: Image

    def mean(self, window: int, pixels: Any = ...) -> Image:
        """Average the known differences in a window around each pixel.

        `pixels` selects the pixels; by default all.
        """
        import cv2

        total, count = (
            cv2.boxFilter(image, -1, (window, window), normalize=False, borderType=cv2.BORDER_CONSTANT)
            for image in (self.value, self.known)
        )
        return np.asarray(total[pixels] / np.maximum(count[pixels], 1))


def compute_inverse_depth_differences(
    inverse: Image, axis: int, max_jump: float, discontinuities: Mask
) -> PixelDifferences:
    """Compute differences of inverse depth along an axis, and mark discontinuities.

    Parameters
    ----------
    inverse : (h, w) inverse depth, 0 where missing.
    axis : 0 along columns, 1 along rows.
    max_jump : maximum relative difference; more is a discontinuity.
    discontinuities : (h, w) mask; pixels on both sides of discontinuities are set in place.
    """
    first, second = (np.s_[:, :-1], np.s_[:, 1:]) if axis else (np.s_[:-1, :], np.s_[1:, :])
    a, b = inverse[first], inverse[second]
    difference = b - a
    smaller = np.minimum(a, b)
    both = smaller > 0
    jump = both & (np.abs(difference) > np.float32(max_jump) * smaller)
    discontinuities[first] |= jump
    discontinuities[second] |= jump
    value, known = np.zeros(inverse.shape, np.float32), np.zeros(inverse.shape, np.float32)
    known[first] = both & ~jump
    np.multiply(difference, known[first], out=value[first])
    return PixelDifferences(value, known)
