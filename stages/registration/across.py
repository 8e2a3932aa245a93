"""Couples of key frames on both sides of a break, so that views taken in no order are joined, too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.registration.graph import Edge

# Only the most alike are looked at: that is soon done, for what is recognised in both is asked first.
_MOST = 500


def across(alike: NDArray[np.float32], parts: NDArray[np.int64]) -> set[tuple[int, int]]:
    """Return couples (later, earlier) of key frames of different parts, as many as are soon looked at.

    Parameters
    ----------
    alike : (n, n) how alike views look. Of small overlaps it tells little: few couples are all taken.
    parts : (n,) which part of a broken chain each is in.
    """
    later, earlier = np.nonzero(np.tril(parts[:, None] != parts))
    order = np.argsort(-alike[later, earlier], kind="stable")[:_MOST]
    return {(int(a), int(b)) for a, b in zip(later[order], earlier[order], strict=True)}


def joined(parts: NDArray[np.int64], edges: Sequence[Edge]) -> NDArray[np.int64]:
    """Return the parts (n,) of key frames after edges have joined some."""
    found: NDArray[np.int64] = parts.copy()
    for edge in edges:
        found[found == found[edge.source]] = found[edge.target]
    return found
