"""Levenberg-Marquardt solver; points are eliminated by the Schur complement (Triggs et al. 2000)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import FREE, STILL
from scanloom.stages.adjusting.problem import Linear, Problem, State

# Damping: initial value, divisor after a good step, factor after a bad step, minimum and maximum.
_DAMPING, _EASED, _TIGHTENED, _LEAST, _MOST = 1e-4, 5.0, 8.0, 1e-8, 1e6
# Minimum relative decrease of the cost; a smaller decrease ends the iteration.
_ENOUGH = 1e-4
# Relative tolerance and maximum iterations of conjugate gradients. Their sums have a fixed order, so that the
# result does not depend on the number of threads.
_SHARE, _ITERATIONS = 1e-7, 600


def solve(problem: Problem, state: State, steps: int) -> State:
    """Minimise the cost from a state in at most `steps` steps."""
    cost, damping = problem.cost(state), _DAMPING
    for _ in range(steps):
        normal = _Normal.of(problem, problem.linear(state), len(state.points))
        while damping < _MOST:
            tried = state.moved(*normal.step(damping))
            found = problem.cost(tried)
            if found < cost:
                break
            damping *= _TIGHTENED
        else:
            break
        gain, state, cost = cost - found, tried, found
        damping = max(damping / _EASED, _LEAST)
        if gain < _ENOUGH * cost:
            break
    return state


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations in blocks of poses, colour camera and points.

    `poses_apart` are the blocks between the two poses of a frame pair. `towards_poses`, `towards_camera` and
    `towards_points` are the right-hand sides.
    """

    problem: Problem
    poses: NDArray[np.float64]
    poses_camera: NDArray[np.float64]
    poses_apart: NDArray[np.float64]
    camera: NDArray[np.float64]
    points: NDArray[np.float64]
    pose_point: NDArray[np.float64]
    camera_point: NDArray[np.float64]
    towards_poses: NDArray[np.float64]
    towards_camera: NDArray[np.float64]
    towards_points: NDArray[np.float64]

    @classmethod
    def of(cls, problem: Problem, linear: Linear, count: int) -> _Normal:
        tracks, views = problem.tracks, len(problem.given)
        pose_t, camera_t, point_t = (
            one.swapaxes(1, 2) for one in (linear.by_pose, linear.by_camera, linear.by_point)
        )
        off = linear.residuals[:, :, None]
        by_point = tracks.point

        def of_points(values: NDArray[np.float64]) -> NDArray[np.float64]:
            # Observations are sorted by point.
            ends = np.searchsorted(by_point, np.arange(count))
            return np.asarray(np.add.reduceat(values, ends, axis=0))

        order = np.argsort(tracks.view, kind="stable")
        used, starts = np.unique(tracks.view[order], return_index=True)

        def of_views(values: NDArray[np.float64]) -> NDArray[np.float64]:
            total = np.zeros((views, *values.shape[1:]))
            total[used] = np.add.reduceat(values[order], starts, axis=0)
            return total

        towards_poses = -of_views(pose_t @ off)[..., 0] - linear.poses
        poses = of_views(pose_t @ linear.by_pose) + np.diag(linear.pose_weights)
        surfaces, met = problem.surfaces, linear.meetings
        first, other = surfaces.couples.T
        begin = np.searchsorted(surfaces.couple, np.arange(len(first)))

        def of_couples(values: NDArray[np.float64]) -> NDArray[np.float64]:
            # Surface points are sorted by frame pair.
            return np.asarray(np.add.reduceat(values, begin, axis=0) if len(begin) else values[:0])

        for which, by in ((first, met.by_first), (other, met.by_other)):
            np.add.at(poses, which, of_couples(by[:, :, None] * by[:, None, :]))
            np.add.at(towards_poses, which, -of_couples(by * met.residuals[:, None]))
        return cls(
            problem=problem,
            poses=poses,
            poses_apart=of_couples(met.by_first[:, :, None] * met.by_other[:, None, :]),
            poses_camera=of_views(pose_t @ linear.by_camera),
            camera=(camera_t @ linear.by_camera).sum(axis=0) + linear.camera_weights,
            points=of_points(point_t @ linear.by_point),
            pose_point=pose_t @ linear.by_point,
            camera_point=of_points(camera_t @ linear.by_point),
            towards_poses=towards_poses,
            towards_camera=-(camera_t @ off).sum(axis=0)[:, 0] - linear.camera,
            towards_points=-of_points(point_t @ off)[..., 0],
        )

    def step(self, damping: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Solve for the damped step of all unknowns.

        Returns
        -------
        Steps of poses (m, 6) or (m, 9), of the colour camera (10,), and of points (p, 3).
        """
        tracks, views, count = self.problem.tracks, len(self.poses), len(self.points)
        # half @ half.T is the inverse of the block of a point.
        half = np.linalg.inv(np.linalg.cholesky(_damped(self.points, damping))).swapaxes(1, 2)
        bridge = _sparse(self.pose_point @ half[tracks.point], tracks.view, tracks.point, (views, count))
        shared = self.camera_point @ half
        ends = (half.swapaxes(1, 2) @ self.towards_points[..., None]).reshape(-1)
        flat = shared.swapaxes(0, 1).reshape(FREE, -1)
        size = self.poses.shape[1]
        free = size * views
        reduced = np.zeros((free + FREE,) * 2)
        at = np.arange(free).reshape(views, size)
        reduced[at[:, :, None], at[:, None, :]] = _damped(self.poses, damping)
        for (first, other), block in zip(self.problem.surfaces.couples, self.poses_apart, strict=True):
            reduced[at[first][:, None], at[other]] += block
            reduced[at[other][:, None], at[first]] += block.T
        for axis in range(STILL, size):
            reduced[np.ix_(at[:, axis], at[:, axis])] += self.problem.turn_coupling
        reduced[:free, :free] -= (bridge @ bridge.T).toarray()
        across = self.poses_camera.reshape(free, FREE) - bridge @ flat.T
        reduced[:free, free:], reduced[free:, :free] = across, across.T
        both = np.einsum("npi,nqi->pq", shared, shared)
        reduced[free:, free:] = _damped(self.camera[None], damping)[0] - both
        towards = np.concatenate(
            [
                self.towards_poses.reshape(-1) - bridge @ ends,
                self.towards_camera - np.einsum("pk,k->p", flat, ends),
            ]
        )
        found = _solved(reduced, towards, size)
        poses, camera = found[:free], found[free:]
        rest = ends - bridge.T @ poses - np.einsum("pk,p->k", flat, camera)
        points = (half @ rest.reshape(-1, 3, 1))[..., 0]
        frees = self.problem.frees.camera
        return poses.reshape(views, size), camera if frees else np.zeros(FREE), points


def _damped(blocks: NDArray[np.float64], damping: float) -> NDArray[np.float64]:
    """Add damping to the diagonals of blocks (n, k, k)."""
    raised = np.array(blocks)
    at = np.arange(blocks.shape[1])
    raised[:, at, at] += damping * blocks[:, at, at] + 1e-9
    return raised


def _sparse(
    blocks: NDArray[np.float64], rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, int]
) -> Any:
    """Assemble a sparse matrix from blocks (n, 6, 3) or (n, 9, 3)."""
    from scipy.sparse import bsr_array

    order = np.lexsort((columns, rows))
    ends = np.searchsorted(rows[order], np.arange(shape[0] + 1))
    size = (blocks.shape[1] * shape[0], 3 * shape[1])
    return bsr_array((blocks[order], columns[order], ends), shape=size)


def _solved(matrix: NDArray[np.float64], towards: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Solve a positive definite system by conjugate gradients.

    Preconditioned with the inverse diagonal blocks; `size` is the number of unknowns per pose.
    """
    from scipy.sparse import block_diag, csr_array
    from scipy.sparse.linalg import cg

    free = len(matrix) - FREE
    blocks = [matrix[n : n + size, n : n + size] for n in range(0, free, size)]
    blocks.append(matrix[free:, free:])
    nearly = csr_array(block_diag([np.linalg.inv(one) for one in blocks]))
    found, _ = cg(csr_array(matrix), towards, rtol=_SHARE, maxiter=_ITERATIONS, M=nearly)
    return np.asarray(found)
