"""Extent of a scan, and the point its cameras look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.params import Point
from scanloom.stages.printing import by_fields
from scanloom.stages.scans.model.scan import Frame

Floats = NDArray[np.float64]

# Percentage of points ignored as outliers at either end of each axis; then the pixel stride.
_STRAY = 1.0
_STEP = 4
# Minimum mean squared sine between the optical axes and their common direction (0.02 is a spread of 8°). The
# intersection of more parallel axes is undetermined.
_LEAST_SPREAD = 0.02
# Limits for accepting the intersection point: median distance of the axes to the point, relative to the
# median viewing distance; ratio of cameras that face the point.
_NEAR_SHARE = 0.25
_LOOKING = 0.8
_ROUNDS = 10
_EXACT = 1e-9


@dataclass(frozen=True)
class Scene:
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

    __repr__ = by_fields

    def __str__(self) -> str:
        return f"{in_words(self.lowest_m)} to {in_words(self.highest_m)}"


def scene_of(frames: Sequence[Frame], views: Sequence[PosedDepth]) -> Scene:
    """Compute the extent and the centre of a scan.

    Parameters
    ----------
    frames : all frames of the scan; only poses are used.
    views : sampled frames with depth.
    """
    points = np.concatenate([view.points(_STEP) for view in views])
    if not len(points):  # images smaller than the stride
        points = np.concatenate([view.points(1) for view in views])
    low, high = np.percentile(points, [_STRAY, 100 - _STRAY], axis=0)
    return Scene(point_of(low), point_of(high), point_of(_center(frames, views, points)))


def point_of(array: Floats) -> Point:
    """Convert an array (3,) to a tuple of floats."""
    x, y, z = array.tolist()
    return x, y, z


def in_words(point: Sequence[float]) -> str:
    """Format a point for messages: `(0.52, -1.3, 2)`."""
    return f"({', '.join(f'{x:.4g}' for x in point)})"


def _center(frames: Sequence[Frame], views: Sequence[PosedDepth], points: Floats) -> Floats:
    poses = [np.asarray(frame.world_from_camera) for frame in frames if frame.world_from_camera is not None]
    meeting = where_axes_meet(np.array([pose for pose in poses if np.isfinite(pose).all()]))
    if meeting is not None:
        return meeting
    # Fallback for cameras that rotate in place or look ahead: median of the points in the image centres.
    middles = [middle for view in views if len(middle := _in_the_middle(view))]
    return np.asarray(np.median(np.concatenate(middles) if middles else points, axis=0))


def _in_the_middle(view: PosedDepth) -> Floats:
    """Return the points (n, 3) in the middle third of an image."""
    height, width = view.surface.depth.shape
    rows, columns = np.nonzero(view.surface.depth)
    inside = (abs(rows - height / 2) < height / 6) & (abs(columns - width / 2) < width / 6)
    return view.world_points(rows[inside][::_STEP], columns[inside][::_STEP])


def where_axes_meet(poses: Floats) -> Floats | None:
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
    for _ in range(_ROUNDS):
        total = np.einsum("n,nij->ij", weights, across) / weights.sum()
        if np.linalg.eigvalsh(total)[0] < _LEAST_SPREAD:
            return None
        place = np.linalg.solve(total, np.einsum("n,nij,nj->i", weights, across, eyes) / weights.sum())
        off = np.linalg.norm(np.einsum("nij,nj->ni", across, place - eyes), axis=1)
        # Weiszfeld step from the mean to the geometric median. The floor prevents a single exact axis from
        # dominating.
        weights = 1 / np.maximum(off, 0.1 * np.median(off) + _EXACT)
    along = np.einsum("ni,ni->n", place - eyes, axes)
    meets = np.median(off) < _NEAR_SHARE * np.median(along)
    return np.asarray(place) if meets and np.mean(along > 0) > _LOOKING else None
