"""Extent of a scan, and the point its cameras look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.params import Point
from scanloom.stages.printing import format_by_fields
from scanloom.stages.scans.model.scan import Frame

Floats = NDArray[np.float64]

# Percentage of points ignored as outliers at either end of each axis; then the pixel stride.
_OUTLIER_PERCENT = 1.0
_PIXEL_STRIDE = 4
# Minimum mean squared sine between the optical axes and their common direction (0.02 is a spread of 8°). The
# intersection of more parallel axes is undetermined.
_MIN_AXIS_SPREAD = 0.02
# Limits for accepting the intersection point: median distance of the axes to the point, relative to the
# median viewing distance; ratio of cameras that face the point.
_MAX_DISTANCE_RATIO = 0.25
_MIN_FACING_RATIO = 0.8
_MAX_ITERATIONS = 10
_MIN_DISTANCE = 1e-9


@dataclass(frozen=True)
class SceneExtent:
    """Extent of a scan, metres in its world.

    Attributes
    ----------
    lowest_m, highest_m : corners of the bounding box of the measured points, without 1 % outliers at each
        side.
    center_m : point the cameras look at; default centre of the ball that `radius` keeps in `fuse`.
    """

    lowest_m: Point
    highest_m: Point
    center_m: Point

    __repr__ = format_by_fields

    def __str__(self) -> str:
        return f"{format_point(self.lowest_m)} to {format_point(self.highest_m)}"


def compute_scene_extent(frames: Sequence[Frame], views: Sequence[PosedDepth]) -> SceneExtent:
    """Compute the extent and the centre of a scan.

    Parameters
    ----------
    frames : all frames of the scan; only poses are used.
    views : sampled frames with depth.
    """
    points = np.concatenate([view.unproject_grid(_PIXEL_STRIDE) for view in views])
    if not len(points):  # images smaller than the stride
        points = np.concatenate([view.unproject_grid(1) for view in views])
    low, high = np.percentile(points, [_OUTLIER_PERCENT, 100 - _OUTLIER_PERCENT], axis=0)
    return SceneExtent(to_point(low), to_point(high), to_point(_find_center(frames, views, points)))


def to_point(array: Floats) -> Point:
    """Convert an array (3,) to a tuple of floats."""
    x, y, z = array.tolist()
    return x, y, z


def format_point(point: Sequence[float]) -> str:
    """Format a point for messages: `(0.52, -1.3, 2)`."""
    return f"({', '.join(f'{x:.4g}' for x in point)})"


def _find_center(frames: Sequence[Frame], views: Sequence[PosedDepth], points: Floats) -> Floats:
    poses = [np.asarray(frame.world_from_camera) for frame in frames if frame.world_from_camera is not None]
    meeting = intersect_optical_axes(np.array([pose for pose in poses if np.isfinite(pose).all()]))
    if meeting is not None:
        return meeting
    # Fallback for cameras that rotate in place or look ahead: median of the points in the image centres.
    middles = [middle for view in views if len(middle := _select_central_points(view))]
    return np.asarray(np.median(np.concatenate(middles) if middles else points, axis=0))


def _select_central_points(view: PosedDepth) -> Floats:
    """Return the points (n, 3) in the middle third of an image."""
    height, width = view.surface.depth.shape
    rows, columns = np.nonzero(view.surface.depth)
    inside = (abs(rows - height / 2) < height / 6) & (abs(columns - width / 2) < width / 6)
    return view.unproject_to_world(rows[inside][::_PIXEL_STRIDE], columns[inside][::_PIXEL_STRIDE])


def intersect_optical_axes(poses: Floats) -> Floats | None:
    """Find the point (3,) closest to all optical axes.

    The point minimises the sum of distances to the axes. Returns None if the axes are almost parallel, or do
    not intersect near the point.

    Parameters
    ----------
    poses : (n, 4, 4) camera-to-world.
    """
    if not len(poses):
        return None
    eyes, axes = poses[:, :3, 3], poses[:, :3, 2]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    weights = np.ones(len(poses))
    for _ in range(_MAX_ITERATIONS):
        total = np.einsum("n,nij->ij", weights, across) / weights.sum()
        if np.linalg.eigvalsh(total)[0] < _MIN_AXIS_SPREAD:
            return None
        point = np.linalg.solve(total, np.einsum("n,nij,nj->i", weights, across, eyes) / weights.sum())
        distance = np.linalg.norm(np.einsum("nij,nj->ni", across, point - eyes), axis=1)
        # Weiszfeld step from the mean to the geometric median. The floor prevents a single exact axis from
        # dominating.
        weights = 1 / np.maximum(distance, 0.1 * np.median(distance) + _MIN_DISTANCE)
    along = np.einsum("ni,ni->n", point - eyes, axes)
    is_intersection = np.median(distance) < _MAX_DISTANCE_RATIO * np.median(along)
    return np.asarray(point) if is_intersection and np.mean(along > 0) > _MIN_FACING_RATIO else None
