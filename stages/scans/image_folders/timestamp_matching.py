"""Pair two streams of images that have clocks instead of numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def nearest_in_time(first: NDArray[np.int64], second: NDArray[np.int64], tolerance: int) -> NDArray[np.int64]:
    """Return for each moment of the first stream the nearest of the second, each used once; -1 for none.

    The closest couples are made first, so that no image takes a partner that suits another better.

    Parameters
    ----------
    first, second : (n,) and (m,) int64 nanoseconds, in any order.
    tolerance : nanoseconds; what is farther apart is no couple.
    """
    order = np.argsort(second, kind="stable")
    starts = np.searchsorted(second[order], first - tolerance, side="left")
    ends = np.searchsorted(second[order], first + tolerance, side="right")
    couples = [
        (abs(int(first[i]) - int(second[j])), i, int(j))
        for i, (start, end) in enumerate(zip(starts, ends, strict=True))
        for j in order[start:end]
    ]
    partner = np.full(len(first), -1, np.int64)
    taken: set[int] = set()
    for _, i, j in sorted(couples):
        if partner[i] < 0 and j not in taken:
            partner[i] = j
            taken.add(j)
    return partner
