"""Align two views by their surfaces (Open3D's projective point-to-plane odometry, coarse to fine)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import open3d
from scanloom.stages.diagnostics.errors import is_lack_of_memory
from scanloom.stages.registration.view import View
from scanloom.stages.scans.model.scan import Pose

# Iterations from the coarsest of three resolutions to the finest; and where the first guess is a mere guess.
_ITERATIONS = (4, 3, 2)
_ROUGH_ITERATIONS = (12, 8, 2)
# Surfaces are compared where they are within this share of the median depth, at least this many metres.
_REACH_SHARE = 0.015
_ROUGH_REACH_SHARE = 0.07
_LEAST_REACH_M = 0.01
# Errors of depth go together over a surface: all of it tells as much as so many points of their own errors.
_POINTS = 200


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let Open3D align on one thread, so that sums are the same every time; pairs run side by side.

    OpenCV's threads, which have nothing to do then, would wait for work as fast as they can.
    """
    import cv2

    utility = open3d().utility
    threads = cv2.getNumThreads()
    utility.set_max_threads(1)
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        utility.set_max_threads(0)


def align(source: View, target: View, start: Pose, max_depth: float) -> tuple[Pose, float] | None:
    """Return the motion (target_from_source) that brings a view's surface onto another's, and how well.

    Parameters
    ----------
    start : (4, 4) first guess.

    Returns
    -------
    pose : (4, 4).
    rmse : distance along the target's normals, metres, root mean square of what meets.
    None, if no motion is found from this guess.
    """
    loss = open3d().t.pipelines.odometry.OdometryLossParams(_reach(source, target))
    return _align(source, target, start, max_depth, loss, _ITERATIONS)


def align_from_afar(source: View, target: View, start: Pose, max_depth: float) -> tuple[Pose, float] | None:
    """Return the same from a guess that may be far off: surfaces farther apart are compared first."""
    reach = max(_ROUGH_REACH_SHARE * min(source.depth_m, target.depth_m), _LEAST_REACH_M)
    # What is far off pulls as it is far: by Open3D's own bound on the pull fewer views come together.
    loss = open3d().t.pipelines.odometry.OdometryLossParams(reach, reach)
    rough = _align(source, target, start, max_depth, loss, _ROUGH_ITERATIONS)
    return None if rough is None else align(source, target, rough[0], max_depth)


def _align(
    source: View, target: View, start: Pose, max_depth: float, loss: Any, iterations: Sequence[int]
) -> tuple[Pose, float] | None:
    o3d = open3d()
    odometry = o3d.t.pipelines.odometry
    try:
        found = odometry.rgbd_odometry_multi_scale(
            source.image,
            target.image,
            _matrix(target),
            o3d.core.Tensor(np.ascontiguousarray(start)),
            1.0,
            float(min(max_depth, 1e3)),
            [odometry.OdometryConvergenceCriteria(n) for n in iterations],
            odometry.Method.PointToPlane,
            loss,
        )
    except RuntimeError as error:
        if is_lack_of_memory(error):
            raise
        # Open3D raises where no pixel meets the other surface, or the system cannot be solved.
        return None
    pose = found.transformation.numpy().astype(np.float64)
    # What Open3D calls the RMSE of odometry is its square.
    return (_orthonormal(pose), float(np.sqrt(found.inlier_rmse))) if np.isfinite(pose).all() else None


def meeting(source: View, target: View, motion: Pose) -> float:
    """Return the share (0 to 1) of a surface that meets another after a motion (target_from_source)."""
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
    # Each point that meets adds an identity to the block of the shift.
    return float(found.numpy()[3, 3]) / max(source.pixels, 1)


def told(target: View, fitness: float) -> NDArray[np.float64]:
    """Return what surfaces that meet tell of the motion to a view, (6, 6) inverse covariance in its axes."""
    return _POINTS * fitness * target.hold


def _reach(source: View, target: View) -> float:
    return max(_REACH_SHARE * min(source.depth_m, target.depth_m), _LEAST_REACH_M)


def _matrix(view: View) -> Any:
    return open3d().core.Tensor(view.camera.matrix)


def _orthonormal(pose: Pose) -> Pose:
    u, _, vt = np.linalg.svd(pose[:3, :3])
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = u @ vt, pose[:3, 3]
    return result
