"""Polygons to triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def split_polygons(
    lengths: NDArray[np.int64], notes: list[str]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split polygons into fans from their first corner, which is right for convex ones.

    Parameters
    ----------
    lengths : (p,) the number of corners of each polygon.
    notes : gets a sentence if polygons were split, or left out for want of corners.

    Returns
    -------
    corners : (m, 3) positions in the list of all polygons' corners, end to end.
    source : (m,) the polygon each triangle comes from.
    """
    if (lengths == 3).all():
        return np.arange(3 * len(lengths)).reshape(-1, 3), np.arange(len(lengths))
    fan = np.maximum(lengths - 2, 0)
    source = np.repeat(np.arange(len(fan)), fan)
    within = np.arange(len(source)) - np.repeat(np.cumsum(fan) - fan, fan)
    first = (np.cumsum(lengths) - lengths)[source]
    if (fan > 1).any():
        notes.append(f"{np.count_nonzero(fan > 1):,} polygons were split into triangles")
    if (fan == 0).any():
        notes.append(f"{np.count_nonzero(fan == 0):,} faces of fewer than three corners are left out")
    return np.stack((first, first + within + 1, first + within + 2), axis=1), source
