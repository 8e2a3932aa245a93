"""Sets of vertices at equal positions, such as duplicates along texture seams."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Vertices

# Large odd numbers without pattern, one per coordinate.
_FACTORS = tuple(np.uint64(factor) for factor in (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9))

# With more repeated keys, sorting all keys with their indices is faster.
_MAX_REPEATED_RATIO = 0.05


def find_equal_positions(vertices: Vertices) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Find the sets of vertices at equal positions.

    Returns
    -------
    sets : (n,) int32, set index of each vertex, numbered from 0 in the order of first vertices.
    first : (s,) first vertex of each set.
    """
    sets = _group_equal_keys(hash_positions(vertices))
    first = find_first_members(sets)
    if not np.array_equal(vertices[first][sets], vertices):
        # Hash collision: two different positions have the same key.
        sets = rank_labels(np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1))
        first = find_first_members(sets)
    return sets, first


def _group_equal_keys(keys: NDArray[np.uint64]) -> NDArray[np.int32]:
    """Compute `rank_labels` of keys, faster if few of them are equal."""
    ordered = np.sort(keys)
    repeated = np.unique(ordered[1:][ordered[1:] == ordered[:-1]])
    if len(repeated) > _MAX_REPEATED_RATIO * len(keys):
        return rank_labels(keys)
    if not len(repeated):
        return np.arange(len(keys), dtype=np.int32)
    place = np.searchsorted(repeated, keys).clip(max=len(repeated) - 1)
    members = np.flatnonzero(repeated[place] == keys)
    group = place[members].astype(np.int32)
    first = members[find_first_members(group)]
    is_first = np.ones(len(keys), np.bool_)
    is_first[members] = False
    is_first[first] = True
    sets = np.asarray(np.cumsum(is_first) - 1, np.int32)
    sets[members] = sets[first][group]
    return sets


def hash_positions(vertices: Vertices) -> NDArray[np.uint64]:
    """Hash positions (n, 3) to 64-bit keys (n,); collisions are very rare.

    The coordinates are mixed in one after the other. In a sum of separate hashes, the signs of mirrored
    positions cancel out.
    """
    # Adding 0 turns −0 into +0, so both have the same bits.
    bits = np.ascontiguousarray(vertices + 0.0).view(np.uint64)
    keys = np.zeros(len(vertices), np.uint64)
    for column, factor in zip(bits.T, _FACTORS, strict=True):
        with np.errstate(over="ignore"):
            keys = (keys + column) * factor
        keys ^= keys >> np.uint64(32)
    return keys


def rank_labels(labels: NDArray[Any]) -> NDArray[np.int32]:
    """Renumber labels from 0 in the order of their first occurrence."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    return rank[inverse.reshape(-1)]


def find_first_members(sets: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the first member (s,) of each set."""
    first = np.empty(int(sets.max(initial=-1)) + 1, np.int64)
    first[sets[::-1]] = np.arange(len(sets))[::-1]
    return first
