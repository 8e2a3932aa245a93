"""Queries for the collapse that merges two vertices.

Collapses form a forest: the parent of each removed vertex is the vertex it was merged into. Two vertices are
merged by the later collapse of the two children just below their lowest common ancestor. The ancestor is
found by binary lifting (Bender and Farach-Colton, "The level ancestor problem simplified", 2004). The number
of steps is logarithmic in the height, because a hostile file can contain a forest of any height.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]


class Meetings:
    """Forest of vertex collapses.

    Parameters
    ----------
    count : number of vertices.
    removed, survivor : (m,) int32, removed vertex of each collapse, and the vertex it was merged into.
    """

    def __init__(self, count: int, removed: NDArray[np.int32], survivor: NDArray[np.int32]) -> None:
        self._never = len(removed)
        self._when = np.full(count, self._never)
        self._when[removed] = np.arange(self._never)
        parent = np.arange(count)
        parent[removed] = survivor
        self._depth = np.zeros(count, np.int64)
        self._depth[removed] = 1
        # Ancestors 1, 2, 4, … levels above each vertex, clamped to the root.
        self._above = [parent]
        twice = parent[parent]
        while (twice != self._above[-1]).any():
            self._depth += self._depth[self._above[-1]]
            self._above.append(twice)
            twice = twice[twice]

    def of(self, a: NDArray[np.int32], b: NDArray[np.int32]) -> Ids:
        """Find the collapse that merges each pair of vertices.

        The result is the number of collapses for pairs that are never merged, and for equal vertices.
        """
        met = np.full(len(a), self._never)
        pairs = np.flatnonzero(a != b)
        low, high = a[pairs].astype(np.int64), b[pairs].astype(np.int64)
        deeper = self._depth[low] < self._depth[high]
        low, high = np.where(deeper, high, low), np.where(deeper, low, high)
        climb = self._depth[low] - self._depth[high]
        # Stop one level below the other vertex, which may itself be the common ancestor.
        low = self._up(low, np.maximum(climb - 1, 0))
        over = self._above[0][low]
        direct = (climb > 0) & (over == high)
        met[pairs[direct]] = self._when[low[direct]]
        low = np.where(climb > 0, over, low)[~direct]
        high, pairs = high[~direct], pairs[~direct]
        for above in reversed(self._above):
            apart = above[low] != above[high]
            low, high = np.where(apart, above[low], low), np.where(apart, above[high], high)
        # Vertices of different trees have reached their roots, which are never removed.
        met[pairs] = np.maximum(self._when[low], self._when[high])
        return met

    def _up(self, vertices: Ids, steps: Ids) -> Ids:
        """Return the ancestor of each vertex, `steps` levels above it."""
        for bit, above in enumerate(self._above):
            vertices = np.where(steps >> bit & 1, above[vertices], vertices)
        return vertices
