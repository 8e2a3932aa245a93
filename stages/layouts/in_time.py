"""Pair two streams that have clocks of their own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def associate(first: NDArray[np.int64], second: NDArray[np.int64], tolerance: int) -> NDArray[np.int64]:
    """Return for each moment of one stream the other's nearest, each used once.

    The closest couples are made first, so that no frame takes a partner that suits another better.

    Parameters
    ----------
    first, second : (n,) and (m,) int64 nanoseconds, in any order.
    tolerance : nanoseconds; moments farther apart are no couple.

    Returns
    -------
    (n,) int64
        Positions in `second`; -1 where none is near enough.
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
