"""Where a point of one posed view may lie in another: on its epipolar line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.stereo.posed_views import PosedView


def fundamental(first: PosedView, second: PosedView) -> NDArray[np.float64]:
    """Return the (3, 3) fundamental matrix: takes pixels of the first view to lines of the second."""
    second_from_first = inverted(second.world_from_camera) @ first.world_from_camera
    x, y, z = second_from_first[:3, 3]
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    k_first, k_second = np.linalg.inv(first.camera.matrix), np.linalg.inv(second.camera.matrix)
    return np.asarray(k_second.T @ across @ second_from_first[:3, :3] @ k_first)


def off_line(
    lines: NDArray[np.float64], here: NDArray[np.float64], there: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return by how many pixels points of the second view are off the lines of those of the first, (n,).

    Parameters
    ----------
    lines : the fundamental matrix of both views.
    here, there : (n, 2) pixels.
    """
    ones = np.ones((len(here), 1))
    line = np.hstack([here, ones]) @ lines.T
    off = np.abs((line * np.hstack([there, ones])).sum(axis=1))
    return np.asarray(off / np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-12))


def off_lines(
    first: PosedView, second: PosedView, here: NDArray[np.float64], there: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return by how many pixels points of two views (n, 2) are off each other's lines, the larger, (n,)."""
    lines = fundamental(first, second)
    return np.maximum(off_line(lines, here, there), off_line(lines.T, there, here))
