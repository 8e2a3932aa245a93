"""Levenberg-Marquardt solver; points are eliminated by the Schur complement (Triggs et al. 2000)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import CAMERA_PARAMETER_COUNT, POSE_PARAMETER_COUNT
from scanloom.stages.adjusting.problem import AdjustmentProblem, AdjustmentState, LinearisedProblem

# Damping: initial value, divisor after a good step, factor after a bad step, minimum and maximum.
_INITIAL_DAMPING, _DAMPING_DIVISOR, _DAMPING_FACTOR, _MIN_DAMPING, _MAX_DAMPING = 1e-4, 5.0, 8.0, 1e-8, 1e6
# Minimum relative decrease of the cost; a smaller decrease ends the iteration.
_MIN_DECREASE_RATIO = 1e-4
# Relative tolerance and maximum iterations of conjugate gradients. Their sums have a fixed order, so that the
# result does not depend on the number of threads.
_CG_TOLERANCE, _CG_MAX_ITERATIONS = 1e-7, 600
# Rows of a block in products of long matrices.
_BLOCK_ROWS = 64


def solve(problem: AdjustmentProblem, state: AdjustmentState, max_steps: int) -> AdjustmentState:
    """Minimise the cost from a state in at most `max_steps` steps."""
    cost, damping = problem.compute_cost(state), _INITIAL_DAMPING
    for _ in range(max_steps):
        normal = _NormalEquations.from_linearised(problem, problem.linearise(state), len(state.points))
        while damping < _MAX_DAMPING:
            tried = state.apply_step(*normal.solve_step(damping))
            found = problem.compute_cost(tried)
            if found < cost:
                break
            damping *= _DAMPING_FACTOR
        else:
            break
        gain, state, cost = cost - found, tried, found
        damping = max(damping / _DAMPING_DIVISOR, _MIN_DAMPING)
        if gain < _MIN_DECREASE_RATIO * cost:
            break
    return state


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    """Normal equations in blocks of poses, colour camera and points.

    `pose_pairs` are the blocks between the two poses of a frame pair. `pose_rhs`, `camera_rhs` and
    `point_rhs` are the right-hand sides.
    """

    problem: AdjustmentProblem
    poses: NDArray[np.float64]
    poses_camera: NDArray[np.float64]
    pose_pairs: NDArray[np.float64]
    camera: NDArray[np.float64]
    points: NDArray[np.float64]
    pose_point: NDArray[np.float64]
    camera_point: NDArray[np.float64]
    pose_rhs: NDArray[np.float64]
    camera_rhs: NDArray[np.float64]
    point_rhs: NDArray[np.float64]

    @classmethod
    def from_linearised(
        cls, problem: AdjustmentProblem, linear: LinearisedProblem, point_count: int
    ) -> _NormalEquations:
        tracks, views = problem.tracks, len(problem.given_poses)
        pose_t, camera_t, point_t = (
            one.swapaxes(1, 2) for one in (linear.by_pose, linear.by_camera, linear.by_point)
        )
        off = linear.residuals[:, :, None]
        by_point = tracks.point_indices

        def sum_by_point(values: NDArray[np.float64]) -> NDArray[np.float64]:
            # Observations are sorted by point.
            ends = np.searchsorted(by_point, np.arange(point_count))
            return np.asarray(np.add.reduceat(values, ends, axis=0))

        order = np.argsort(tracks.view_indices, kind="stable")
        used, starts = np.unique(tracks.view_indices[order], return_index=True)

        def sum_by_view(values: NDArray[np.float64]) -> NDArray[np.float64]:
            total = np.zeros((views, *values.shape[1:]))
            total[used] = np.add.reduceat(values[order], starts, axis=0)
            return total

        towards_poses = -sum_by_view(pose_t @ off)[..., 0] - linear.pose_gradient
        poses = sum_by_view(pose_t @ linear.by_pose) + np.diag(linear.pose_weights)
        surfaces, surface_residuals = problem.surfaces, linear.surface_residuals
        first, other = surfaces.pair_indices.T
        begin = np.searchsorted(surfaces.pair_of_point, np.arange(len(first)))

        def sum_by_pair(values: NDArray[np.float64]) -> NDArray[np.float64]:
            # Surface points are sorted by frame pair.
            return np.asarray(np.add.reduceat(values, begin, axis=0) if len(begin) else values[:0])

        for which, by in ((first, surface_residuals.by_first), (other, surface_residuals.by_other)):
            np.add.at(poses, which, sum_by_pair(by[:, :, None] * by[:, None, :]))
            np.add.at(towards_poses, which, -sum_by_pair(by * surface_residuals.residuals[:, None]))
        poses_camera = sum_by_view(pose_t @ linear.by_camera)
        camera_rhs = -(camera_t @ off).sum(axis=0)[:, 0] - linear.camera_gradient
        if problem.free.depth:
            by_depth, depth = surface_residuals.by_depth, slice(CAMERA_PARAMETER_COUNT, None)
            for which, by in ((first, surface_residuals.by_first), (other, surface_residuals.by_other)):
                blocks = np.array([by[part].T @ by_depth[part] for part in _slice_pairs(begin, len(by))])
                np.add.at(poses_camera[:, :, depth], which, blocks)
            camera = _multiply_transposed(linear.by_camera.reshape(-1, linear.by_camera.shape[2]))
            camera += linear.camera_weights
            camera[depth, depth] += _multiply_transposed(by_depth)
            camera_rhs[depth] -= np.einsum("ki,k->i", by_depth, surface_residuals.residuals)
        else:
            camera = (camera_t @ linear.by_camera).sum(axis=0) + linear.camera_weights
        return cls(
            problem=problem,
            poses=poses,
            pose_pairs=sum_by_pair(
                surface_residuals.by_first[:, :, None] * surface_residuals.by_other[:, None, :]
            ),
            poses_camera=poses_camera,
            camera=camera,
            points=sum_by_point(point_t @ linear.by_point),
            pose_point=pose_t @ linear.by_point,
            camera_point=sum_by_point(camera_t @ linear.by_point),
            pose_rhs=towards_poses,
            camera_rhs=camera_rhs,
            point_rhs=-sum_by_point(point_t @ off)[..., 0],
        )

    def solve_step(
        self, damping: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Solve for the damped step of all unknowns.

        Returns
        -------
        Steps of poses (m, 6) or (m, 9), of the colour camera and depth (10 + d,), and of points (p, 3).
        """
        tracks, views, count = self.problem.tracks, len(self.poses), len(self.points)
        # half @ half.T is the inverse of the block of a point.
        half = np.linalg.inv(np.linalg.cholesky(_add_damping(self.points, damping))).swapaxes(1, 2)
        bridge = _build_sparse_matrix(
            self.pose_point @ half[tracks.point_indices],
            tracks.view_indices,
            tracks.point_indices,
            (views, count),
        )
        shared = self.camera_point @ half
        ends = (half.swapaxes(1, 2) @ self.point_rhs[..., None]).reshape(-1)
        shared_count = len(self.camera)
        flat = shared.swapaxes(0, 1).reshape(shared_count, -1)
        size = self.poses.shape[1]
        free = size * views
        reduced = np.zeros((free + shared_count,) * 2)
        at = np.arange(free).reshape(views, size)
        reduced[at[:, :, None], at[:, None, :]] = _add_damping(self.poses, damping)
        for (first, other), block in zip(self.problem.surfaces.pair_indices, self.pose_pairs, strict=True):
            reduced[at[first][:, None], at[other]] += block
            reduced[at[other][:, None], at[first]] += block.T
        for axis in range(POSE_PARAMETER_COUNT, size):
            reduced[np.ix_(at[:, axis], at[:, axis])] += self.problem.shutter_coupling
        reduced[:free, :free] -= (bridge @ bridge.T).toarray()
        across = self.poses_camera.reshape(free, shared_count) - bridge @ flat.T
        reduced[:free, free:], reduced[free:, :free] = across, across.T
        both = np.einsum("npi,nqi->pq", shared, shared)
        reduced[free:, free:] = _add_damping(self.camera[None], damping)[0] - both
        towards = np.concatenate(
            [
                self.pose_rhs.reshape(-1) - bridge @ ends,
                self.camera_rhs - np.einsum("pk,k->p", flat, ends),
            ]
        )
        found = _solve_system(reduced, towards, size, free)
        poses, camera = found[:free], found[free:]
        rest = ends - bridge.T @ poses - np.einsum("pk,p->k", flat, camera)
        points = (half @ rest.reshape(-1, 3, 1))[..., 0]
        if not self.problem.free.camera:
            camera[:CAMERA_PARAMETER_COUNT] = 0
        return poses.reshape(views, size), camera, points


def _slice_pairs(begin: NDArray[np.intp], count: int) -> list[slice]:
    """Return the slice of the surface points of each frame pair."""
    return [slice(*ends) for ends in itertools.pairwise([*begin.tolist(), count])]


def _multiply_transposed(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute rows.T @ rows (d, d) for many rows (n, d), in blocks of a fixed size.

    Small products run on one thread, so that the order of the sums does not depend on the number of threads.
    """
    padded = np.zeros((-(-len(rows) // _BLOCK_ROWS) * _BLOCK_ROWS, rows.shape[1]))
    padded[: len(rows)] = rows
    blocks = padded.reshape(-1, _BLOCK_ROWS, rows.shape[1])
    return np.asarray((blocks.swapaxes(1, 2) @ blocks).sum(axis=0))


def _add_damping(blocks: NDArray[np.float64], damping: float) -> NDArray[np.float64]:
    """Add damping to the diagonals of blocks (n, k, k)."""
    raised = np.array(blocks)
    at = np.arange(blocks.shape[1])
    raised[:, at, at] += damping * blocks[:, at, at] + 1e-9
    return raised


def _build_sparse_matrix(
    blocks: NDArray[np.float64], rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, int]
) -> Any:
    """Assemble a sparse matrix from blocks (n, 6, 3) or (n, 9, 3)."""
    from scipy.sparse import bsr_array

    order = np.lexsort((columns, rows))
    ends = np.searchsorted(rows[order], np.arange(shape[0] + 1))
    size = (blocks.shape[1] * shape[0], 3 * shape[1])
    return bsr_array((blocks[order], columns[order], ends), shape=size)


def _solve_system(
    matrix: NDArray[np.float64], right_side: NDArray[np.float64], block_size: int, free: int
) -> NDArray[np.float64]:
    """Solve a positive definite system by conjugate gradients.

    Preconditioned with the inverse diagonal blocks. The first `free` unknowns belong to poses, `block_size`
    to each; the last block belongs to the cameras.
    """
    from scipy.sparse import block_diag, csr_array
    from scipy.sparse.linalg import cg

    blocks = [matrix[n : n + block_size, n : n + block_size] for n in range(0, free, block_size)]
    blocks.append(matrix[free:, free:])
    nearly = csr_array(block_diag([np.linalg.inv(one) for one in blocks]))
    found, _ = cg(csr_array(matrix), right_side, rtol=_CG_TOLERANCE, maxiter=_CG_MAX_ITERATIONS, M=nearly)
    return np.asarray(found)
