"""Timestamp matching of the images of two streams."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def nearest_in_time(first: NDArray[np.int64], second: NDArray[np.int64], tolerance: int) -> NDArray[np.int64]:
    """Match each timestamp of the first stream to one of the second.

    Matches are one-to-one. The closest pairs are matched first, so that no image takes a partner that is
    closer to another image.

    Parameters
    ----------
    first, second : (n,) and (m,) int64 timestamps in nanoseconds, in any order.
    tolerance : maximum time difference of a pair, nanoseconds.

    Returns
    -------
    (n,) int64
        Indices into `second`; -1 if there is no match.
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
