"""Epipolar geometry of two posed views."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.stereo.posed_views import PosedView


def compute_fundamental_matrix(first: PosedView, second: PosedView) -> NDArray[np.float64]:
    """Return the fundamental matrix (3, 3).

    It maps pixels of the first view to epipolar lines of the second view.
    """
    second_from_first = invert_pose(second.world_from_camera) @ first.world_from_camera
    x, y, z = second_from_first[:3, 3]
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    k_first, k_second = np.linalg.inv(first.camera.matrix), np.linalg.inv(second.camera.matrix)
    return np.asarray(k_second.T @ across @ second_from_first[:3, :3] @ k_first)


def compute_epipolar_distance(
    fundamental_matrix: NDArray[np.float64], here: NDArray[np.float64], there: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return distances (n,) of points to their epipolar lines, pixels.

    Parameters
    ----------
    fundamental_matrix : fundamental matrix from the first to the second view.
    here, there : (n, 2) corresponding pixels of the first and second view.
    """
    ones = np.ones((len(here), 1))
    line = np.hstack([here, ones]) @ fundamental_matrix.T
    off = np.abs((line * np.hstack([there, ones])).sum(axis=1))
    return np.asarray(off / np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-12))


def compute_symmetric_distance(
    first: PosedView, second: PosedView, here: NDArray[np.float64], there: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the symmetric epipolar distance (n,) of correspondences, pixels.

    The distance is the larger one of both views.

    Parameters
    ----------
    here, there : (n, 2) corresponding pixels of the first and second view.
    """
    lines = compute_fundamental_matrix(first, second)
    return np.maximum(
        compute_epipolar_distance(lines, here, there), compute_epipolar_distance(lines.T, there, here)
    )
