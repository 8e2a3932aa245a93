"""Lists of unequal length, one after the other in one array."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.edges import Ids


def spread(start: Ids, count: Ids) -> tuple[Ids, Ids]:
    """Return for each list of `count` items from `start` on: whose item it is, and where it is."""
    owner = np.repeat(np.arange(len(count)), count)
    before = np.cumsum(count) - count
    return owner, np.arange(len(owner)) + np.repeat(start - before, count)


def distinct_pairs(owner: Ids, item: Ids, limit: int) -> tuple[Ids, Ids]:
    """Return the pairs of an owner and an item below `limit`, each once, ascending."""
    one, other = np.divmod(np.unique(owner * limit + item), limit)
    return one, other
