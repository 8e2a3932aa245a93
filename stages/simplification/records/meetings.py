"""When two vertices become one.

Collapses make a forest: each vertex hangs below the one it went into, which is itself removed later or
never. Two vertices are one from the collapse on that takes the later of the two just below their lowest
common ancestor. That is found by doubling (Bender and Farach-Colton, "The level ancestor problem simplified",
2004), in steps as many as the logarithm of the forest's height, for a hostile file can give it any height.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]


class Meetings:
    """The forest of some collapses.

    Parameters
    ----------
    count : how many vertices there are.
    removed, survivor : (m,) int32, for each collapse the vertex that vanished and the one it went into.
    """

    def __init__(self, count: int, removed: NDArray[np.int32], survivor: NDArray[np.int32]) -> None:
        self._never = len(removed)
        self._when = np.full(count, self._never)
        self._when[removed] = np.arange(self._never)
        parent = np.arange(count)
        parent[removed] = survivor
        self._depth = np.zeros(count, np.int64)
        self._depth[removed] = 1
        # The ancestor 1, 2, 4, … above each vertex; the root for fewer.
        self._above = [parent]
        twice = parent[parent]
        while (twice != self._above[-1]).any():
            self._depth += self._depth[self._above[-1]]
            self._above.append(twice)
            twice = twice[twice]

    def of(self, a: NDArray[np.int32], b: NDArray[np.int32]) -> Ids:
        """Return for each pair of vertices the number of the collapse that makes them one.

        It is the number of collapses for two that never become one, or that are one from the start.
        """
        met = np.full(len(a), self._never)
        pairs = np.flatnonzero(a != b)
        low, high = a[pairs].astype(np.int64), b[pairs].astype(np.int64)
        deeper = self._depth[low] < self._depth[high]
        low, high = np.where(deeper, high, low), np.where(deeper, low, high)
        climb = self._depth[low] - self._depth[high]
        # First to just below the level of the other, for that may itself be the ancestor.
        low = self._up(low, np.maximum(climb - 1, 0))
        over = self._above[0][low]
        direct = (climb > 0) & (over == high)
        met[pairs[direct]] = self._when[low[direct]]
        low = np.where(climb > 0, over, low)[~direct]
        high, pairs = high[~direct], pairs[~direct]
        for above in reversed(self._above):
            apart = above[low] != above[high]
            low, high = np.where(apart, above[low], low), np.where(apart, above[high], high)
        # Those in different trees are roots by now, which never vanish.
        met[pairs] = np.maximum(self._when[low], self._when[high])
        return met

    def _up(self, vertices: Ids, steps: Ids) -> Ids:
        """Return the ancestor that many steps above each vertex."""
        for bit, above in enumerate(self._above):
            vertices = np.where(steps >> bit & 1, above[vertices], vertices)
        return vertices
