"""Groups of triangle corners that share a vertex, connected over triangle sides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]

_NEXT_CORNER = [1, 2, 0]


def group_corners(
    points: NDArray[np.integer], is_linked: Callable[[Indices, Indices], NDArray[np.bool_]]
) -> NDArray[np.int32]:
    """Group corners at the same point whose triangles are connected over linked sides.

    Parameters
    ----------
    points : (m, 3) point of each corner.
    is_linked : function of two sides (k,) of adjacent triangles that pass them in opposite directions. Side
        3 t + c of triangle t starts at its corner c.

    Returns
    -------
    (3 m,) group of each corner.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    starts, ends = points.reshape(-1), points[:, _NEXT_CORNER].reshape(-1)
    low, high, is_reversed = np.minimum(starts, ends), np.maximum(starts, ends), starts > ends
    order = np.lexsort((is_reversed, high, low))
    one, other = order[:-1], order[1:]
    is_shared = is_reversed[one] != is_reversed[other]
    for point in (low, high):
        is_shared &= point[one] == point[other]
    one, other = one[is_shared], other[is_shared]
    linked = is_linked(one, other)
    one, other = one[linked], other[linked]
    rows = np.concatenate([one, find_side_ends(one)])
    columns = np.concatenate([find_side_ends(other), other])
    links = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(points.size, points.size))
    return np.asarray(connected_components(links, directed=False)[1], np.int32)


def find_side_ends(sides: Indices) -> Indices:
    """Return the corners at which sides (k,) end."""
    return sides - sides % 3 + (sides + 1) % 3
