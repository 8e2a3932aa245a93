"""Align two views by their surfaces (Open3D's projective point-to-plane odometry, coarse to fine)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages._open3d import open3d
from stages.registration.view import View
from stages.scan import Pose

# Iterations from the coarsest of three resolutions to the finest.
_ITERATIONS = (12, 8, 8)
# Surfaces are compared where they are within this share of the median depth, at least this many metres.
_REACH_SHARE = 0.015
_LEAST_REACH_M = 0.01


@dataclass(frozen=True, eq=False)
class Aligned:
    """How a view fits another.

    Attributes
    ----------
    target_from_source : (4, 4) metres.
    fitness : share of the source's pixels that meet the target's surface within the reach.
    rmse_m : their distance along the target's normals, root mean square.
    """

    target_from_source: Pose
    fitness: float
    rmse_m: float


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let Open3D align on one thread, so that sums are the same every time; pairs run side by side."""
    utility = open3d().utility
    utility.set_max_threads(1)
    try:
        yield
    finally:
        utility.set_max_threads(0)


def align(source: View, target: View, start: Pose, max_depth: float) -> Aligned | None:
    """Return the motion that brings a view's surface onto another's, from a first guess, if one is found."""
    o3d = open3d()
    odometry = o3d.t.pipelines.odometry
    reach = _reach(source, target)
    steps = [odometry.OdometryConvergenceCriteria(n) for n in _ITERATIONS]
    try:
        found = odometry.rgbd_odometry_multi_scale(
            source.image,
            target.image,
            _matrix(target),
            o3d.core.Tensor(np.ascontiguousarray(start)),
            1.0,
            float(min(max_depth, 1e3)),
            steps,
            odometry.Method.PointToPlane,
            odometry.OdometryLossParams(reach),
        )
    except RuntimeError:
        # Open3D raises where no pixel meets the other surface, or the system cannot be solved.
        return None
    pose = found.transformation.numpy().astype(np.float64)
    if not np.isfinite(pose).all():
        return None
    # What Open3D calls the RMSE of odometry is its square.
    return Aligned(_orthonormal(pose), float(found.fitness), float(np.sqrt(found.inlier_rmse)))


def information(source: View, target: View, motion: Pose) -> NDArray[np.float64]:
    """Return the (6, 6) information matrix of a motion, from the points that both views show."""
    o3d = open3d()
    found = o3d.t.pipelines.odometry.compute_odometry_information_matrix(
        source.image.depth,
        target.image.depth,
        _matrix(target),
        o3d.core.Tensor(np.ascontiguousarray(motion)),
        _reach(source, target),
        1.0,
        1e3,
    )
    return np.asarray(found.numpy(), np.float64)


def _reach(source: View, target: View) -> float:
    return max(_REACH_SHARE * min(source.depth_m, target.depth_m), _LEAST_REACH_M)


def _matrix(view: View) -> Any:
    return open3d().core.Tensor(view.camera.matrix)


def _orthonormal(pose: Pose) -> Pose:
    u, _, vt = np.linalg.svd(pose[:3, :3])
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = u @ vt, pose[:3, 3]
    return result
