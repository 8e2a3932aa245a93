"""Places of the classes that `check` finds: vertices, edges by their ends, or triangles, by numbers."""

from __future__ import annotations

import numpy as np

from scanloom.stages.cleaning.check import CLASSES
from scanloom.stages.surface.edges import Ids

# The classes with a repair, in the order of their numbers.
REPAIRABLE = tuple(name for name, (_, treatment, _) in CLASSES.items() if treatment == "marking")


def is_of_triangles(name: str) -> bool:
    """Return whether the places of a class are triangles."""
    return CLASSES[name][0] == "triangle"


def edge_keys(ends: Ids, vertex_count: int) -> Ids:
    """Return a number for each edge by its ends (k, 2), the smaller first."""
    return np.asarray(ends[:, 0].astype(np.int64) * vertex_count + ends[:, 1])


def missing_in(some: Ids, others: Ids) -> Ids:
    """Return the places of one class, ascending, that others do not contain."""
    if some.ndim == 1:
        return np.setdiff1d(some, others)
    limit = int(max(some.max(initial=0), others.max(initial=0))) + 1
    keys = np.setdiff1d(edge_keys(some, limit), edge_keys(others, limit))
    return np.stack(np.divmod(keys, limit), axis=1)
