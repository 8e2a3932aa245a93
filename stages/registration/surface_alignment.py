"""Surface alignment of two views: Open3D's projective point-to-plane odometry, coarse to fine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.diagnostics.errors import is_out_of_memory
from scanloom.stages.registration.view import RegistrationView
from scanloom.stages.scans.model.scan import Pose

# Iterations from the coarsest to the finest of three resolutions, for a good and for a poor initial guess.
_ITERATIONS = (4, 3, 2)
_ROUGH_ITERATIONS = (12, 8, 2)
# Maximum correspondence distance, relative to the median depth, for a good and for a poor initial guess; then
# its minimum in metres.
_REACH_RATIO = 0.015
_ROUGH_REACH_RATIO = 0.07
_MIN_REACH_M = 0.01
# Number of independent points that a whole surface is worth, because depth errors of neighbours are
# correlated.
_EFFECTIVE_POINT_COUNT = 200


@contextmanager
def limit_threads() -> Iterator[None]:
    """Limit Open3D to one thread per alignment, for reproducible sums.

    Frame pairs are aligned in parallel instead. OpenCV is limited, too: its idle threads would busy-wait.
    """
    import cv2

    utility = import_open3d().utility
    threads = cv2.getNumThreads()
    utility.set_max_threads(1)
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        utility.set_max_threads(0)


def align(
    source: RegistrationView, target: RegistrationView, initial: Pose, max_depth: float
) -> tuple[Pose, float] | None:
    """Align the surfaces of two views from a good initial guess.

    Parameters
    ----------
    source, target : views to align.
    initial : (4, 4) initial target_from_source.
    max_depth : farther depth is ignored, metres.

    Returns
    -------
    pose : (4, 4) target_from_source.
    rmse : point-to-plane distance of the correspondences, root mean square, metres.
    None instead of both, if the alignment fails.
    """
    loss = import_open3d().t.pipelines.odometry.OdometryLossParams(_get_reach(source, target))
    return _align(source, target, initial, max_depth, loss, _ITERATIONS)


def align_from_afar(
    source: RegistrationView, target: RegistrationView, initial: Pose, max_depth: float
) -> tuple[Pose, float] | None:
    """Align the surfaces of two views from a poor initial guess.

    A coarse alignment with a larger correspondence distance comes first. Parameters and results as for
    `align`.
    """
    reach = max(_ROUGH_REACH_RATIO * min(source.depth_m, target.depth_m), _MIN_REACH_M)
    # The second value is the Huber threshold. With Open3D's default (0.05 m) fewer views align.
    loss = import_open3d().t.pipelines.odometry.OdometryLossParams(reach, reach)
    rough = _align(source, target, initial, max_depth, loss, _ROUGH_ITERATIONS)
    return None if rough is None else align(source, target, rough[0], max_depth)


def _align(
    source: RegistrationView,
    target: RegistrationView,
    initial: Pose,
    max_depth: float,
    loss: Any,
    iterations: Sequence[int],
) -> tuple[Pose, float] | None:
    o3d = import_open3d()
    odometry = o3d.t.pipelines.odometry
    try:
        found = odometry.rgbd_odometry_multi_scale(
            source.image,
            target.image,
            _to_intrinsics_tensor(target),
            o3d.core.Tensor(np.ascontiguousarray(initial)),
            1.0,
            float(min(max_depth, 1e3)),
            [odometry.OdometryConvergenceCriteria(n) for n in iterations],
            odometry.Method.PointToPlane,
            loss,
        )
    except RuntimeError as error:
        if is_out_of_memory(error):
            raise
        # Open3D raises if there are no correspondences, or if the system is singular.
        return None
    pose = found.transformation.numpy().astype(np.float64)
    # Open3D's `inlier_rmse` of odometry is the mean square, not its root.
    return (
        (_orthonormalize_pose(pose), float(np.sqrt(found.inlier_rmse))) if np.isfinite(pose).all() else None
    )


def compute_overlap(source: RegistrationView, target: RegistrationView, motion: Pose) -> float:
    """Compute the overlap of two views after a motion (target_from_source).

    The overlap is the ratio of the source's surface that meets the target's surface, 0 to 1.
    """
    o3d = import_open3d()
    found = o3d.t.pipelines.odometry.compute_odometry_information_matrix(
        source.image.depth,
        target.image.depth,
        _to_intrinsics_tensor(target),
        o3d.core.Tensor(np.ascontiguousarray(motion)),
        _get_reach(source, target),
        1.0,
        1e3,
    )
    # Each correspondence adds an identity to the translation block of the information matrix.
    return float(found.numpy()[3, 3]) / max(source.valid_pixel_count, 1)


def compute_surface_information(target: RegistrationView, fitness: float) -> NDArray[np.float64]:
    """Compute the information matrix (6, 6) of aligned surfaces, target axes.

    Parameters
    ----------
    fitness : overlap, 0 to 1.
    """
    return _EFFECTIVE_POINT_COUNT * fitness * target.information_per_point


def _get_reach(source: RegistrationView, target: RegistrationView) -> float:
    return max(_REACH_RATIO * min(source.depth_m, target.depth_m), _MIN_REACH_M)


def _to_intrinsics_tensor(view: RegistrationView) -> Any:
    return import_open3d().core.Tensor(view.camera.matrix)


def _orthonormalize_pose(pose: Pose) -> Pose:
    u, _, vt = np.linalg.svd(pose[:3, :3])
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = u @ vt, pose[:3, 3]
    return result
