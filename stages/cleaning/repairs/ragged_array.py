"""Ragged arrays: lists of different lengths, concatenated in one array."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.edges import Ids


def expand_slices(start: Ids, count: Ids) -> tuple[Ids, Ids]:
    """Enumerate the items of slices [start, start + count).

    Returns
    -------
    owner : slice of each item.
    position : index of each item in the concatenated array.
    """
    owner = np.repeat(np.arange(len(count)), count)
    before = np.cumsum(count) - count
    return owner, np.arange(len(owner)) + np.repeat(start - before, count)


def find_distinct_pairs(owner: Ids, item: Ids, limit: int) -> tuple[Ids, Ids]:
    """Return the distinct pairs of owner and item, ascending.

    `limit` is an exclusive upper bound of the items.
    """
    one, other = np.divmod(np.unique(owner * limit + item), limit)
    return one, other
