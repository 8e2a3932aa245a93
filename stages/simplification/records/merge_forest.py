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


class MergeForest:
    """Forest of vertex collapses.

    Parameters
    ----------
    count : number of vertices.
    removed, survivor : (m,) int32, removed vertex of each collapse, and the vertex it was merged into.
    """

    def __init__(self, count: int, removed: NDArray[np.int32], survivor: NDArray[np.int32]) -> None:
        self._collapse_count = len(removed)
        self._removal_steps = np.full(count, self._collapse_count)
        self._removal_steps[removed] = np.arange(self._collapse_count)
        parent = np.arange(count)
        parent[removed] = survivor
        self._depth = np.zeros(count, np.int64)
        self._depth[removed] = 1
        # Ancestors 1, 2, 4, … levels above each vertex, clamped to the root.
        self._ancestors = [parent]
        twice = parent[parent]
        while (twice != self._ancestors[-1]).any():
            self._depth += self._depth[self._ancestors[-1]]
            self._ancestors.append(twice)
            twice = twice[twice]

    def find_merges(self, a: NDArray[np.int32], b: NDArray[np.int32]) -> Ids:
        """Find the collapse that merges each pair of vertices.

        The result is the number of collapses for pairs that are never merged, and for equal vertices.
        """
        merge_steps = np.full(len(a), self._collapse_count)
        pairs = np.flatnonzero(a != b)
        low, high = a[pairs].astype(np.int64), b[pairs].astype(np.int64)
        deeper = self._depth[low] < self._depth[high]
        low, high = np.where(deeper, high, low), np.where(deeper, low, high)
        climb = self._depth[low] - self._depth[high]
        # Stop one level below the other vertex, which may itself be the common ancestor.
        low = self._find_ancestors(low, np.maximum(climb - 1, 0))
        over = self._ancestors[0][low]
        direct = (climb > 0) & (over == high)
        merge_steps[pairs[direct]] = self._removal_steps[low[direct]]
        low = np.where(climb > 0, over, low)[~direct]
        high, pairs = high[~direct], pairs[~direct]
        for above in reversed(self._ancestors):
            apart = above[low] != above[high]
            low, high = np.where(apart, above[low], low), np.where(apart, above[high], high)
        # Vertices of different trees have reached their roots, which are never removed.
        merge_steps[pairs] = np.maximum(self._removal_steps[low], self._removal_steps[high])
        return merge_steps

    def _find_ancestors(self, vertices: Ids, steps: Ids) -> Ids:
        """Return the ancestor of each vertex, `steps` levels above it."""
        for bit, above in enumerate(self._ancestors):
            vertices = np.where(steps >> bit & 1, above[vertices], vertices)
        return vertices
