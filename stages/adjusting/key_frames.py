"""Which frames of a long scan are adjusted together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A turn of a radian shows as much that is new as a way of a metre and a half.
_M_PER_RADIAN = 1.5


def key_frames(poses: NDArray[np.float64], most: int) -> NDArray[np.intp]:
    """Return the places of at most `most` poses (m, 4, 4) that are spread evenly over the camera's way."""
    if len(poses) <= most:
        return np.arange(len(poses))
    shifts = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    cosines = (np.einsum("nij,nij->n", poses[:-1, :3, :3], poses[1:, :3, :3]) - 1) / 2
    steps = shifts + _M_PER_RADIAN * np.arccos(np.clip(cosines, -1, 1))
    # One that jumps is no longer than others; one that stands still is a little on its way.
    usual = float(np.median(steps))
    way = np.concatenate([[0], np.cumsum(steps.clip(0.1 * usual, 10 * usual) + 1e-9)])
    return np.unique(np.searchsorted(way, np.linspace(0, way[-1], most) * (1 - 1e-12)))
