"""Poses of views brought nearer to what the views recognise in each other, held to those that are given.

Points that two views recognise lie on each other's epipolar lines, if the poses are right. Each pose moves so
that they come nearer to their lines, without places of the points themselves (epipolar adjustment), held to
where it was given: what the lines leave open, such as the scale, stays as it is. Damped Gauss-Newton steps,
with weights by which wrong matches count little.

Rodehorst, Heinrichs and Hellwich, "Evaluation of relative pose estimation methods for multi-camera setups",
2008; Sampson, "Fitting conic sections to very scattered data", 1982; Huber, "Robust statistics", 1981.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import Pose
from scanloom.stages.stereo.epipolar import off_lines
from scanloom.stages.stereo.posed_views import PosedView

Floats = NDArray[np.float64]

# How far poses may be off: turned by so much (radians), and moved by this share of the distance to the scene.
_PRIOR = 0.01
# Pixels that a match is off by itself.
_EXACT_PX = 1.0
# A match in so many is held out, and judges.
_HELD_OUT = 5
# What is found is used if held-out points come nearer to their lines by this share.
_BETTER_SHARE = 0.2
_STEPS = 15
_ENOUGH = 1e-3  # Steps of less than this share of the prior are none.
_SMALL = 1e-6  # What a pose is moved by to see where that leads.


@dataclass(frozen=True, eq=False)
class Nearer:
    """Poses that fit better.

    Attributes
    ----------
    poses : world_from_camera of all views.
    before, after : pixels, how far the median held-out point is off its lines.
    """

    poses: tuple[Pose, ...]
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class _Matches:
    """Points that pairs of views recognise: the views, the rays of z = 1, and pixels a unit of ray."""

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    here: Floats
    there: Floats
    focal: Floats


def nearer_poses(
    views: Sequence[PosedView],
    matched: Mapping[tuple[int, int], tuple[Floats, Floats]],
    distance: float,
) -> Nearer | None:
    """Bring poses nearer to what views recognise in each other; None if that makes nothing better.

    Parameters
    ----------
    views : without distortion.
    matched : by the places of two views, the pixels (n, 2) of both that are recognised to be the same.
    distance : metres from the views to the scene, roughly.
    """
    fitted = _gathered(views, {pair: _every(points, held=False) for pair, points in matched.items()})
    judging = {pair: _every(points, held=True) for pair, points in matched.items()}
    before = _median_off(views, judging)
    if len(fitted.first) == 0 or not np.isfinite(before):
        return None
    poses = _solved(np.stack([view.world_from_camera for view in views]), fitted, distance)
    moved = [replace(view, world_from_camera=pose) for view, pose in zip(views, poses, strict=True)]
    after = _median_off(moved, judging)
    if not after < (1 - _BETTER_SHARE) * before:
        return None
    return Nearer(tuple(poses), before, after)


def _every(points: tuple[Floats, Floats], *, held: bool) -> tuple[Floats, Floats]:
    chosen = (np.arange(len(points[0])) % _HELD_OUT == 0) == held
    return points[0][chosen], points[1][chosen]


def _median_off(
    views: Sequence[PosedView], matched: Mapping[tuple[int, int], tuple[Floats, Floats]]
) -> float:
    off = [off_lines(views[a], views[b], *points) for (a, b), points in matched.items()]
    every = np.concatenate(off) if off else np.zeros(0)
    return float(np.median(every)) if len(every) else np.nan


def _gathered(
    views: Sequence[PosedView], matched: Mapping[tuple[int, int], tuple[Floats, Floats]]
) -> _Matches:
    pairs = list(matched)
    counts = [len(matched[pair][0]) for pair in pairs]
    rays = [
        np.concatenate(
            [views[pair[side]].rays(*matched[pair][side].T) for pair in pairs] or [np.zeros((0, 3))]
        )
        for side in (0, 1)
    ]
    focal = [(views[a].camera.fx + views[b].camera.fx) / 2 for a, b in pairs]
    return _Matches(
        np.repeat(np.array([a for a, _ in pairs], np.intp), counts),
        np.repeat(np.array([b for _, b in pairs], np.intp), counts),
        rays[0],
        rays[1],
        np.repeat(np.array(focal, np.float64), counts),
    )


def _solved(given: Floats, matches: _Matches, distance: float) -> Floats:
    """Return the poses (n, 4, 4) at which points come nearest to their lines."""
    from scipy.sparse import coo_matrix, identity
    from scipy.sparse.linalg import spsolve

    count = len(given)
    # Of each pose: turned by so much, moved by so much; both in units of the prior.
    unit = _PRIOR * np.array([1.0] * 3 + [distance] * 3)
    moved = np.zeros((count, 6))
    damping = 1e-3
    error, step = _total(given, moved, unit, matches), np.zeros((count, 6))
    for _ in range(_STEPS):
        off, slopes = _linearized(_at(given, moved, unit), unit, matches)
        weight = 1 / np.sqrt(1 + (off / _EXACT_PX) ** 2)
        columns = np.concatenate(
            [6 * matches.first[:, None] + np.arange(6), 6 * matches.second[:, None] + np.arange(6)], axis=1
        )
        rows = np.repeat(np.arange(len(off)), 12)
        slope = coo_matrix((slopes.ravel(), (rows, columns.ravel())), (len(off), 6 * count)).tocsr()
        weighted = slope.multiply(weight[:, None] / _EXACT_PX**2).tocsr()
        normal = (slope.T @ weighted + identity(6 * count)).tocsc()
        wanted = -(weighted.T @ off) - moved.ravel()
        while damping < 1e6:
            step = spsolve(normal + damping * identity(6 * count, format="csc"), wanted).reshape(count, 6)
            tried = _total(given, moved + step, unit, matches)
            if tried < error:
                moved, error, damping = moved + step, tried, damping / 10
                break
            damping *= 10
        if damping >= 1e6 or np.abs(step).max() < _ENOUGH:
            break
    return _at(given, moved, unit)


def _total(given: Floats, moved: Floats, unit: Floats, matches: _Matches) -> float:
    """Return what is made small: how far points are off their lines, and poses off those given."""
    off = _sampson(_at(given, moved, unit), matches)
    robust = 2 * (np.sqrt(1 + (off / _EXACT_PX) ** 2) - 1)
    return float(robust.sum() + (moved**2).sum())


def _at(given: Floats, moved: Floats, unit: Floats) -> Floats:
    """Return poses (n, 4, 4) turned and moved in their own axes by (n, 6) units."""
    from scipy.spatial.transform import Rotation

    by = moved * unit
    poses = given.copy()
    poses[:, :3, :3] = given[:, :3, :3] @ Rotation.from_rotvec(by[:, :3]).as_matrix()
    poses[:, :3, 3] += np.einsum("nij,nj->ni", given[:, :3, :3], by[:, 3:])
    return np.asarray(poses)


def _sampson(poses: Floats, matches: _Matches) -> Floats:
    """Return how far points are off their epipolar lines, both at once, in pixels (n,), with a sign."""
    first, second = poses[matches.first], poses[matches.second]
    # In world axes, so that a pose of one view alone is turned for it.
    across = second[:, :3, 3] - first[:, :3, 3]
    here = np.einsum("nij,nj->ni", first[:, :3, :3], matches.here)
    there = np.einsum("nij,nj->ni", second[:, :3, :3], matches.there)
    # here · (across × there) = 0: both rays and the line between the views lie in one plane.
    plane_of_there, plane_of_here = np.cross(across, there), np.cross(here, across)
    value = (here * plane_of_there).sum(axis=1)
    by_here = np.einsum("nji,nj->ni", first[:, :3, :3], plane_of_there)[:, :2]
    by_there = np.einsum("nji,nj->ni", second[:, :3, :3], plane_of_here)[:, :2]
    size = np.sqrt((by_here**2).sum(axis=1) + (by_there**2).sum(axis=1))
    return np.asarray(matches.focal * value / np.maximum(size, np.finfo(np.float64).tiny))


def _linearized(poses: Floats, unit: Floats, matches: _Matches) -> tuple[Floats, Floats]:
    """Return how far points are off (n,), and how that goes with the six units of both poses (n, 12)."""
    off = _sampson(poses, matches)
    slopes = np.empty((len(off), 12))
    # All first views of pairs are moved at once, then all second ones.
    count = len(poses)
    both = np.concatenate([poses, poses])
    apart = _Matches(matches.first, matches.second + count, matches.here, matches.there, matches.focal)
    for k in range(12):
        by = np.zeros((2 * count, 6))
        by[:count, k % 6] = _SMALL * (k < 6)
        by[count:, k % 6] = _SMALL * (k >= 6)
        slopes[:, k] = (_sampson(_at(both, by, unit), apart) - off) / _SMALL
    return off, slopes
