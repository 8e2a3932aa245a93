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
from scanloom.stages.stereo.epipolar import compute_symmetric_distance
from scanloom.stages.stereo.posed_views import PosedView

Floats = NDArray[np.float64]

# Standard deviation of the pose prior: rotation in radians, translation relative to the distance to the
# scene.
_PRIOR_SIGMA = 0.01
# Standard deviation of a match, pixels.
_MATCH_SIGMA_PX = 1.0
# Every n-th match is held out to evaluate the result.
_HELD_OUT_INTERVAL = 5
# Minimum relative reduction of the held-out error for the result to be used.
_MIN_IMPROVEMENT_RATIO = 0.2
_MAX_ITERATIONS = 15
_CONVERGED_STEP = 1e-3  # convergence: maximum step, in standard deviations of the prior
_DERIVATIVE_STEP = 1e-6  # step of numerical derivatives


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """Refined poses.

    Attributes
    ----------
    poses : world_from_camera of all views.
    error_before, error_after : median epipolar distance of held-out matches, pixels.
    """

    poses: tuple[Pose, ...]
    error_before: float
    error_after: float


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


def refine_poses(
    views: Sequence[PosedView],
    matches: Mapping[tuple[int, int], tuple[Floats, Floats]],
    scene_distance: float,
) -> RefinedPoses | None:
    """Refine poses from feature matches.

    Parameters
    ----------
    views : undistorted views.
    matches : by indices of two views, matching pixels (n, 2) of both.
    scene_distance : rough distance from the views to the scene, metres.

    Returns
    -------
    Refined poses; None if the held-out matches do not improve enough.
    """
    fitted_matches = _concatenate_matches(
        views, {pair: _select_matches(points, is_held_out=False) for pair, points in matches.items()}
    )
    held_out = {pair: _select_matches(points, is_held_out=True) for pair, points in matches.items()}
    before = _compute_median_distance(views, held_out)
    if len(fitted_matches.first) == 0 or not np.isfinite(before):
        return None
    poses = _solve_poses(np.stack([view.world_from_camera for view in views]), fitted_matches, scene_distance)
    refined_views = [replace(view, world_from_camera=pose) for view, pose in zip(views, poses, strict=True)]
    after = _compute_median_distance(refined_views, held_out)
    if not after < (1 - _MIN_IMPROVEMENT_RATIO) * before:
        return None
    return RefinedPoses(tuple(poses), before, after)


def _select_matches(points: tuple[Floats, Floats], *, is_held_out: bool) -> tuple[Floats, Floats]:
    chosen = (np.arange(len(points[0])) % _HELD_OUT_INTERVAL == 0) == is_held_out
    return points[0][chosen], points[1][chosen]


def _compute_median_distance(
    views: Sequence[PosedView], matched: Mapping[tuple[int, int], tuple[Floats, Floats]]
) -> float:
    off = [compute_symmetric_distance(views[a], views[b], *points) for (a, b), points in matched.items()]
    every = np.concatenate(off) if off else np.zeros(0)
    return float(np.median(every)) if len(every) else np.nan


def _concatenate_matches(
    views: Sequence[PosedView], matched: Mapping[tuple[int, int], tuple[Floats, Floats]]
) -> _Matches:
    pairs = list(matched)
    counts = [len(matched[pair][0]) for pair in pairs]
    rays = [
        np.concatenate(
            [views[pair[side]].compute_rays(*matched[pair][side].T) for pair in pairs] or [np.zeros((0, 3))]
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


def _solve_poses(given: Floats, matches: _Matches, scene_distance: float) -> Floats:
    """Return the refined poses (n, 4, 4)."""
    from scipy.sparse import coo_matrix, identity
    from scipy.sparse.linalg import spsolve

    count = len(given)
    # Six unknowns per pose, rotation and translation, in standard deviations of the prior.
    unit = _PRIOR_SIGMA * np.array([1.0] * 3 + [scene_distance] * 3)
    changes = np.zeros((count, 6))
    damping = 1e-3
    cost, step = _compute_cost(given, changes, unit, matches), np.zeros((count, 6))
    for _ in range(_MAX_ITERATIONS):
        residuals, derivatives = _linearize(_apply_pose_changes(given, changes, unit), unit, matches)
        weight = 1 / np.sqrt(1 + (residuals / _MATCH_SIGMA_PX) ** 2)
        columns = np.concatenate(
            [6 * matches.first[:, None] + np.arange(6), 6 * matches.second[:, None] + np.arange(6)], axis=1
        )
        rows = np.repeat(np.arange(len(residuals)), 12)
        jacobian = coo_matrix(
            (derivatives.ravel(), (rows, columns.ravel())), (len(residuals), 6 * count)
        ).tocsr()
        weighted = jacobian.multiply(weight[:, None] / _MATCH_SIGMA_PX**2).tocsr()
        normal = (jacobian.T @ weighted + identity(6 * count)).tocsc()
        right_side = -(weighted.T @ residuals) - changes.ravel()
        while damping < 1e6:
            step = spsolve(normal + damping * identity(6 * count, format="csc"), right_side).reshape(count, 6)
            new_cost = _compute_cost(given, changes + step, unit, matches)
            if new_cost < cost:
                changes, cost, damping = changes + step, new_cost, damping / 10
                break
            damping *= 10
        if damping >= 1e6 or np.abs(step).max() < _CONVERGED_STEP:
            break
    return _apply_pose_changes(given, changes, unit)


def _compute_cost(given: Floats, changes: Floats, unit: Floats, matches: _Matches) -> float:
    """Return the cost: robust epipolar distances plus the pose prior."""
    off = _compute_sampson_distance(_apply_pose_changes(given, changes, unit), matches)
    robust = 2 * (np.sqrt(1 + (off / _MATCH_SIGMA_PX) ** 2) - 1)
    return float(robust.sum() + (changes**2).sum())


def _apply_pose_changes(given: Floats, changes: Floats, unit: Floats) -> Floats:
    """Apply pose changes (n, 6) to poses (n, 4, 4).

    Rotation and translation are in camera axes, in standard deviations of the prior.
    """
    from scipy.spatial.transform import Rotation

    by = changes * unit
    poses = given.copy()
    poses[:, :3, :3] = given[:, :3, :3] @ Rotation.from_rotvec(by[:, :3]).as_matrix()
    poses[:, :3, 3] += np.einsum("nij,nj->ni", given[:, :3, :3], by[:, 3:])
    return np.asarray(poses)


def _compute_sampson_distance(poses: Floats, matches: _Matches) -> Floats:
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


def _linearize(poses: Floats, unit: Floats, matches: _Matches) -> tuple[Floats, Floats]:
    """Return the residuals (n,), and their derivatives by both poses (n, 12)."""
    residuals = _compute_sampson_distance(poses, matches)
    derivatives = np.empty((len(residuals), 12))
    # Perturbs the first views of all pairs at once, then the second views. Separate copies keep them
    # independent.
    count = len(poses)
    both = np.concatenate([poses, poses])
    separate_matches = _Matches(
        matches.first, matches.second + count, matches.here, matches.there, matches.focal
    )
    for k in range(12):
        changes = np.zeros((2 * count, 6))
        changes[:count, k % 6] = _DERIVATIVE_STEP * (k < 6)
        changes[count:, k % 6] = _DERIVATIVE_STEP * (k >= 6)
        derivatives[:, k] = (
            _compute_sampson_distance(_apply_pose_changes(both, changes, unit), separate_matches) - residuals
        ) / _DERIVATIVE_STEP
    return residuals, derivatives
