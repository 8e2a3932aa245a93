"""Defects as index arrays: vertices, edges as vertex pairs, or triangles."""

from __future__ import annotations

import numpy as np

from scanloom.stages.cleaning.check import CLASSES
from scanloom.stages.surface.edges import Ids

# Classes that can be repaired; the position is the class index of an operation.
REPAIRABLE = tuple(name for name, (_, treatment, _) in CLASSES.items() if treatment == "marking")


def is_triangle_class(name: str) -> bool:
    """Return True if the elements of a class are triangles."""
    return CLASSES[name][0] == "triangle"


def compute_edge_keys(ends: Ids, vertex_count: int) -> Ids:
    """Compute a unique key for each edge (k, 2).

    The smaller vertex index must come first.
    """
    return np.asarray(ends[:, 0].astype(np.int64) * vertex_count + ends[:, 1])


def find_missing(some: Ids, others: Ids) -> Ids:
    """Return the elements of one class, ascending, that are not in `others`."""
    if len(some) == 0 or len(others) == 0:
        return some
    if some.ndim == 1:
        return np.setdiff1d(some, others)
    limit = int(max(some.max(initial=0), others.max(initial=0))) + 1
    keys = np.setdiff1d(compute_edge_keys(some, limit), compute_edge_keys(others, limit))
    return np.stack(np.divmod(keys, limit), axis=1)
