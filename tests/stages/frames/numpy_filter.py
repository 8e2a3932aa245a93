"""Reference implementation of the depth filter in NumPy and OpenCV, for comparison with the kernel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.depth_filter import OrientedDepth, compute_inverse_depth_differences, fill_gaps
from scanloom.stages.scans.model.scan import Camera, DepthImage

Image = NDArray[np.float32]

# Differences are averaged over this many pixels in each direction: enough to smooth the depth quantisation of
# a structured-light sensor, few enough to keep the edge of a table.
_WINDOW = 5
# A pixel more oblique than this (70 degrees) is accepted only on a plane, such as a road: averaged over a
# wider window, its slope must be about the same. Otherwise it belongs to a round or ragged outline, where the
# distance along the normal is unknown, and its obliqueness is clamped to this value; beyond `_SMEARED` it
# belongs to a smeared discontinuity.
_STEEP = 2.9
_SMEARED = 5.0
_WIDE_WINDOW = 25
_LIKE = 1.5


def orient_depth(depth: DepthImage, camera: Camera, *, max_jump: float, max_angle: float) -> OrientedDepth:
    """Estimate surface orientation; remove pixels at depth discontinuities and oblique pixels.

    Sensors and matchers produce "flying" pixels between the near and the far surface of a discontinuity, so
    both sides of it are removed. Gaps of one pixel between similar depths are bridged: depth that was warped
    into the view of a colour camera has many of them.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    max_jump : depth change between neighbouring pixels, relative to depth, that makes a discontinuity.
    max_angle : degrees between the line of sight and the surface normal.
    """
    depth, inverse = fill_gaps(depth, max_jump)
    torn = np.zeros(depth.shape, bool)
    across, down = (compute_inverse_depth_differences(inverse, axis, max_jump, torn) for axis in (1, 0))
    rays = _compute_rays(camera)
    normal = _compute_normal(depth, camera, rays.columns, rays.rows, across.mean(_WINDOW), down.mean(_WINDOW))
    obliqueness = _compute_length(normal)
    steep = np.nonzero(obliqueness > _STEEP)
    wide = _compute_length(
        _compute_normal(
            depth[steep],
            camera,
            rays.columns[steep[1]],
            rays.rows[steep[0], 0],
            across.mean(_WIDE_WINDOW, steep),
            down.mean(_WIDE_WINDOW, steep),
        )
    )
    narrow = obliqueness[steep]
    curved = (wide >= _LIKE * narrow) | (wide * _LIKE <= narrow)
    torn[steep] |= curved & (narrow > _SMEARED)
    for image in (*normal, obliqueness):
        image[steep] *= np.where(curved, np.float32(_STEEP) / narrow, np.float32(1))
    # Cosine of the viewing angle: 1 / (obliqueness · length of the ray).
    too_oblique = obliqueness * rays.length * np.float32(np.cos(np.radians(max_angle))) > 1
    depth[torn | too_oblique] = 0
    return OrientedDepth(depth, normal, obliqueness)


def _compute_normal(
    depth: Image, camera: Camera, columns: Image, rows: Image, across: Image, down: Image
) -> tuple[Image, Image, Image]:
    """Compute the normal, with d ln z = −z d(1/z); see OrientedDepth for its length."""
    x = np.float32(-camera.fx) * depth * across
    y = np.float32(-camera.fy) * depth * down
    return x, y, -(1 + columns * x + rows * y)


def _compute_length(vector: tuple[Image, Image, Image]) -> Image:
    x, y, z = vector
    return np.asarray(np.sqrt(x * x + y * y + z * z))


@dataclass(frozen=True, eq=False)
class _Rays:
    """Viewing rays (x/z, y/z, 1): x/z of each column (w,), y/z of each row (h, 1), lengths (h, w)."""

    columns: Image
    rows: Image
    length: Image


@lru_cache(maxsize=8)
def _compute_rays(camera: Camera) -> _Rays:
    columns = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    rows = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)[:, None]
    return _Rays(columns, rows, np.sqrt(1 + columns**2 + rows**2))
