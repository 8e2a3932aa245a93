"""Refinement of camera poses from feature matches.

Matches between two views are on each other's epipolar lines if the poses are right. The refinement minimises
the distances to the epipolar lines without estimating 3-D points (epipolar adjustment). The given poses are a
prior, which holds everything that matches do not constrain, such as the scale. The solver takes damped
Gauss-Newton steps with robust weights against outliers.

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

# Standard deviation of the pose prior: rotation in radians, translation relative to the distance to the
# scene.
_PRIOR = 0.01
# Standard deviation of a match, pixels.
_EXACT_PX = 1.0
# Every n-th match is held out to evaluate the result.
_HELD_OUT = 5
# Minimum relative reduction of the held-out error for the result to be used.
_BETTER_SHARE = 0.2
_STEPS = 15
_ENOUGH = 1e-3  # convergence: maximum step, in standard deviations of the prior
_SMALL = 1e-6  # step of numerical derivatives


@dataclass(frozen=True, eq=False)
class Nearer:
    """Refined poses.

    Attributes
    ----------
    poses : world_from_camera of all views.
    before, after : median epipolar distance of held-out matches, pixels.
    """

    poses: tuple[Pose, ...]
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class _Matches:
    """Feature matches of all pairs of views, concatenated.

    Attributes
    ----------
    first, second : (n,) indices of the views.
    here, there : (n, 3) rays of z = 1 in camera axes.
    focal : (n,) pixels, mean focal length of both views.
    """

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
    """Refine poses from feature matches.

    Parameters
    ----------
    views : undistorted views.
    matched : by indices of two views, matching pixels (n, 2) of both.
    distance : rough distance from the views to the scene, metres.

    Returns
    -------
    Refined poses; None if the held-out matches do not improve enough.
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
    """Return the refined poses (n, 4, 4)."""
    from scipy.sparse import coo_matrix, identity
    from scipy.sparse.linalg import spsolve

    count = len(given)
    # Six unknowns per pose, rotation and translation, in standard deviations of the prior.
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
    """Return the cost: robust epipolar distances plus the pose prior."""
    off = _sampson(_at(given, moved, unit), matches)
    robust = 2 * (np.sqrt(1 + (off / _EXACT_PX) ** 2) - 1)
    return float(robust.sum() + (moved**2).sum())


def _at(given: Floats, moved: Floats, unit: Floats) -> Floats:
    """Apply pose changes (n, 6) to poses (n, 4, 4).

    Rotation and translation are in camera axes, in standard deviations of the prior.
    """
    from scipy.spatial.transform import Rotation

    by = moved * unit
    poses = given.copy()
    poses[:, :3, :3] = given[:, :3, :3] @ Rotation.from_rotvec(by[:, :3]).as_matrix()
    poses[:, :3, 3] += np.einsum("nij,nj->ni", given[:, :3, :3], by[:, 3:])
    return np.asarray(poses)


def _sampson(poses: Floats, matches: _Matches) -> Floats:
    """Return the signed Sampson distance (n,) of the matches, pixels."""
    first, second = poses[matches.first], poses[matches.second]
    # In world axes, so that rays are rotated once per pose instead of once per pair.
    across = second[:, :3, 3] - first[:, :3, 3]
    here = np.einsum("nij,nj->ni", first[:, :3, :3], matches.here)
    there = np.einsum("nij,nj->ni", second[:, :3, :3], matches.there)
    # here · (across × there) = 0: both rays and the baseline are coplanar.
    plane_of_there, plane_of_here = np.cross(across, there), np.cross(here, across)
    value = (here * plane_of_there).sum(axis=1)
    by_here = np.einsum("nji,nj->ni", first[:, :3, :3], plane_of_there)[:, :2]
    by_there = np.einsum("nji,nj->ni", second[:, :3, :3], plane_of_here)[:, :2]
    size = np.sqrt((by_here**2).sum(axis=1) + (by_there**2).sum(axis=1))
    return np.asarray(matches.focal * value / np.maximum(size, np.finfo(np.float64).tiny))


def _linearized(poses: Floats, unit: Floats, matches: _Matches) -> tuple[Floats, Floats]:
    """Return the residuals (n,), and their derivatives by both poses (n, 12)."""
    off = _sampson(poses, matches)
    slopes = np.empty((len(off), 12))
    # Perturbs the first views of all pairs at once, then the second views. Separate copies keep them
    # independent.
    count = len(poses)
    both = np.concatenate([poses, poses])
    apart = _Matches(matches.first, matches.second + count, matches.here, matches.there, matches.focal)
    for k in range(12):
        by = np.zeros((2 * count, 6))
        by[:count, k % 6] = _SMALL * (k < 6)
        by[count:, k % 6] = _SMALL * (k >= 6)
        slopes[:, k] = (_sampson(_at(both, by, unit), apart) - off) / _SMALL
    return off, slopes
