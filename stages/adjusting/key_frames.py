"""Selection of the key frames that are adjusted together in a long scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Metres of translation that change the view about as much as a rotation of one radian.
_M_PER_RADIAN = 1.5


def select_key_frames(poses: NDArray[np.float64], max_count: int) -> NDArray[np.intp]:
    """Select key frames evenly along the path of the camera.

    Parameters
    ----------
    poses : (m, 4, 4) world_from_camera.
    max_count : maximum number of key frames.

    Returns
    -------
    Ascending indices of the key frames.
    """
    if len(poses) <= max_count:
        return np.arange(len(poses))
    shifts = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    cosines = (np.einsum("nij,nij->n", poses[:-1, :3, :3], poses[1:, :3, :3]) - 1) / 2
    steps = shifts + _M_PER_RADIAN * np.arccos(np.clip(cosines, -1, 1))
    # Steps are clipped: a jump must not attract many key frames, and a camera at rest still needs some.
    usual = float(np.median(steps))
    way = np.concatenate([[0], np.cumsum(steps.clip(0.1 * usual, 10 * usual) + 1e-9)])
    return np.unique(np.searchsorted(way, np.linspace(0, way[-1], max_count) * (1 - 1e-12)))
