"""Mesh of a single frame, with pixels as vertices.

Neighbouring pixels are connected where depth does not jump. No other frame fills the surface that a TSDF
volume tears or loses at silhouettes. A constant voxel size is too large close to the camera. Far from the
camera, noise spans many voxels. A pixel mesh covers all measured depth at its native resolution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.depth_filter import PixelDifferences, compute_inverse_depth_differences, fill_gaps
from scanloom.stages.frames.posed_depth import DepthLimits, PosedDepth, read_posed_depth
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, to_pinhole
from scanloom.stages.surface.mesh import Mesh

Mask = NDArray[np.bool_]
Triangles = NDArray[np.int32]

# Denoising window: this many steps in each direction, with this stride in pixels.
_WINDOW_STEPS, _WINDOW_STRIDE = 3, 3
# Window for the mean slope and noise, pixels in each direction.
_MEAN_WINDOW = 15
# Pixels farther from the local plane than this many standard deviations belong to another surface.
_MAX_DEVIATIONS = 3.0
# Mean absolute value of a Gaussian error, in standard deviations.
_MEAN_ERROR = math.sqrt(2 / math.pi)
# Maximum triangle count of a single-frame mesh.
_MAX_TRIANGLES = 2_000_000


def denoise_single_frame(frames: Sequence[Frame], max_jump: float) -> Sequence[Frame]:
    """Denoise the depth of a single frame.

    Several frames are returned unchanged, because fusion averages their noise. A frame that cannot be read is
    returned unchanged, too.
    """
    if len(frames) != 1:
        return frames
    (frame,) = frames
    try:
        depth, photo = read_depth(frame), read_color(frame)
    except InputError:
        return frames  # reported where the frame is read
    if depth is None:
        return frames
    depth, _ = fill_gaps(depth, max_jump)
    # Reading has already applied lens distortion, confidence, mask, rolling shutter and depth correction.
    return [
        replace(
            frame,
            depth=denoise_depth(depth, max_jump),
            camera=to_pinhole(frame.camera),
            color=photo,
            color_camera=None if frame.color_camera is None else to_pinhole(frame.color_camera),
            confidence=None,
            min_confidence=0,
            mask=None,
            shutter_turn=None,
            depth_correction=None,
        )
    ]


def denoise_depth(depth: DepthImage, max_jump: float) -> DepthImage:
    """Smooth depth by averaging pixels on the same local plane.

    The inverse depth of a plane is linear in pixel coordinates. Each pixel takes the mean of its neighbours'
    inverse depth, extrapolated to the pixel along the local slope. The noise is estimated locally from
    differences of adjacent pixels. Neighbours farther from the plane than the noise allows are ignored as
    another surface. Missing pixels stay missing.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    max_jump : relative change of depth between neighbours at a discontinuity.
    """
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    slopes, error = [], np.zeros_like(depth)
    torn = np.zeros(depth.shape, bool)
    for axis in (1, 0):
        found = compute_inverse_depth_differences(inverse, axis, max_jump, torn)
        slope = found.mean(_MEAN_WINDOW)
        slopes.append(slope)
        off_slope = np.abs(found.value - slope) * found.known
        error += PixelDifferences(off_slope, found.known).mean(_MEAN_WINDOW) / 2
    # Limit for the difference of two pixels; `error` is a mean absolute difference.
    limit = np.minimum(_MAX_DEVIATIONS * error / _MEAN_ERROR, np.float32(max_jump) * inverse)
    total, count = np.zeros_like(depth), np.ones_like(depth)
    across, down = slopes
    for dy in range(-_WINDOW_STEPS * _WINDOW_STRIDE, _WINDOW_STEPS * _WINDOW_STRIDE + 1, _WINDOW_STRIDE):
        for dx in range(-_WINDOW_STEPS * _WINDOW_STRIDE, _WINDOW_STEPS * _WINDOW_STRIDE + 1, _WINDOW_STRIDE):
            here, there = _make_neighbour_slices(depth.shape, dy, dx)
            if (dy, dx) == (0, 0) or not inverse[here].size:
                continue
            residual = inverse[there] - inverse[here] - dx * across[here] - dy * down[here]
            is_inlier = (inverse[there] > 0) & (np.abs(residual) <= limit[here])
            total[here] += np.where(is_inlier, residual, 0)
            count[here] += is_inlier
    smoothed = inverse + total / count
    return np.asarray(np.divide(1, smoothed, out=np.zeros_like(depth), where=depth > 0), np.float32)


def read_unfiltered_depth(frame: Frame, limits: DepthLimits) -> PosedDepth:
    """Read the depth of a frame, including pixels next to depth jumps.

    Volume fusion drops these pixels, because flying pixels would fill voxels. In a pixel mesh, triangles end
    there.

    Raises
    ------
    InputError
        As `read_posed_depth`.
    """
    view = read_posed_depth(frame, limits)
    depth = read_depth(frame)
    assert depth is not None
    depth[(depth < limits.min_depth) | (depth > limits.max_depth)] = 0
    return replace(view, surface=replace(view.surface, depth=np.maximum(depth, view.surface.depth)))


def mesh_depth_map(
    view: PosedDepth, mask: Mask, color: ColorImage | None, voxel_size: float, limits: DepthLimits
) -> Mesh:
    """Mesh the pixels of a frame, in world coordinates.

    Parameters
    ----------
    mask : (h, w), pixels to include.
    color : (h, w, 3) uint8 of the same size.
    voxel_size : metres; vertices are half of this apart at median depth. The minimum is the pixel spacing;
        the vertex count is limited to about one million.
    limits : triangles across depth jumps and triangles seen at more than the maximum angle are omitted.
    """
    step = _compute_stride(view, mask, voxel_size)
    grid = np.s_[::step, ::step]
    depth = np.where(mask, view.surface.depth, np.float32(0))[grid]
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    triangles = _triangulate_pixels(inverse, limits.max_jump)
    rows, columns = np.divmod(np.arange(depth.size), depth.shape[1])
    triangles = triangles[
        _compute_view_angles(view.unproject_to_camera(step * rows, step * columns), triangles)
        <= limits.max_angle
    ]
    used = np.zeros(depth.size, bool)
    used[triangles] = True
    rank = np.cumsum(used, dtype=np.int32) - 1
    rows, columns = np.divmod(np.flatnonzero(used), depth.shape[1])
    vertices = view.unproject_to_world(step * rows, step * columns)
    colors = None if color is None else _average_color(color, step)[grid][rows, columns]
    return Mesh(vertices, rank[triangles].astype(np.int32), colors)


def _compute_view_angles(points: NDArray[np.float32], triangles: Triangles) -> NDArray[np.float64]:
    """Return the angles between triangle normals and lines of sight.

    Returns
    -------
    (m,) degrees; 90 for triangles without area.
    """
    a, b, c = (points[triangles[:, k]].astype(np.float64) for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1) * np.linalg.norm(a, axis=1)
    facing = np.abs(np.einsum("ij,ij->i", normal, a))
    return np.asarray(
        np.degrees(np.arccos(np.divide(facing, size, out=np.zeros_like(size), where=size > 0).clip(0, 1)))
    )


def _compute_stride(view: PosedDepth, mask: Mask, voxel_size: float) -> int:
    """Return the pixel stride between vertices."""
    depth = view.surface.depth[mask]
    spacing = float(np.median(depth)) / view.camera.fx
    return max(1, round(voxel_size / (2 * spacing)), math.ceil(math.sqrt(2 * len(depth) / _MAX_TRIANGLES)))


def _triangulate_pixels(inverse: DepthImage, max_jump: float) -> Triangles:
    """Connect neighbouring pixels to triangles (m, 3), front-facing to the camera.

    Each pixel quad is split along the diagonal with the smaller difference of inverse depth. If one corner is
    missing or across a depth jump, the quad keeps one triangle.
    """
    height, width = inverse.shape
    number = np.arange(height * width, dtype=np.int32).reshape(height, width)
    places = (np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:])
    corners = [number[place].ravel() for place in places]
    value = [inverse[place].ravel() for place in places]

    def is_connected(a: int, b: int) -> Mask:
        least = np.minimum(value[a], value[b])
        return np.asarray((least > 0) & (np.abs(value[a] - value[b]) <= np.float32(max_jump) * least))

    sides = [is_connected(k, (k + 1) % 4) for k in range(4)]
    first, second = is_connected(0, 2), is_connected(1, 3)
    straight = np.abs(value[0] - value[2]) <= np.abs(value[1] - value[3])
    is_complete = sides[0] & sides[1] & sides[2] & sides[3]
    by_first = first & (straight | ~second | ~is_complete)
    by_second = second & ~(by_first & is_complete)
    found = []
    # Counterclockwise in the image, whose y axis points down.
    for wanted, (a, b, c), (k, m) in (
        (by_first, (0, 1, 2), (0, 1)),
        (by_first, (0, 2, 3), (2, 3)),
        (by_second, (0, 1, 3), (0, 3)),
        (by_second, (1, 2, 3), (1, 2)),
    ):
        kept = wanted & sides[k] & sides[m]
        found.append(np.stack([corners[i][kept] for i in (a, b, c)], axis=1))
    triangles = np.concatenate(found)
    return triangles[np.argsort(triangles[:, 0], kind="stable")]


def _average_color(color: ColorImage, step: int) -> ColorImage:
    import cv2

    return color if step == 1 else np.asarray(cv2.blur(color, (step, step)), np.uint8)


def _make_neighbour_slices(
    shape: tuple[int, ...], dy: int, dx: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return slices of pixels, and of their neighbours at (dy, dx)."""

    def slice_axis(size: int, by: int) -> tuple[slice, slice]:
        long = max(size - abs(by), 0)
        return slice(max(-by, 0), max(-by, 0) + long), slice(max(by, 0), max(by, 0) + long)

    (y, v), (x, u) = slice_axis(shape[0], dy), slice_axis(shape[1], dx)
    return (y, x), (v, u)
