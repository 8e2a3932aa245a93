"""Timestamp matching of the images of two streams."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def match_timestamps(
    timestamps: NDArray[np.int64], other_timestamps: NDArray[np.int64], tolerance_ns: int
) -> NDArray[np.int64]:
    """Match each timestamp of the first stream to one of the second.

    Matches are one-to-one. The closest pairs are matched first, so that no image takes a partner that is
    closer to another image.

    Parameters
    ----------
    timestamps, other_timestamps : (n,) and (m,) int64 timestamps in nanoseconds, in any order.
    tolerance_ns : maximum time difference of a pair, nanoseconds.

    Returns
    -------
    (n,) int64
        Indices into `other_timestamps`; -1 if there is no match.
    """
    order = np.argsort(other_timestamps, kind="stable")
    starts = np.searchsorted(other_timestamps[order], timestamps - tolerance_ns, side="left")
    ends = np.searchsorted(other_timestamps[order], timestamps + tolerance_ns, side="right")
    candidates = [
        (abs(int(timestamps[i]) - int(other_timestamps[j])), i, int(j))
        for i, (start, end) in enumerate(zip(starts, ends, strict=True))
        for j in order[start:end]
    ]
    partner = np.full(len(timestamps), -1, np.int64)
    taken: set[int] = set()
    for _, i, j in sorted(candidates):
        if partner[i] < 0 and j not in taken:
            partner[i] = j
            taken.add(j)
    return partner
