"""Geometrically similar vertices: copies that files make of one, and parts that touch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.surface.equal_positions import equal_positions, first_members, position_keys, rank_labels
from scanloom.stages.surface.mesh import Triangles, Vertices
from scanloom.stages.surface.sheets import taken_apart

# Pairs a vertex may have on average before `similar_distance` is taken for a mistake.
_MOST_PAIRS = 64
# Factor between the distances at which vertices are joined, and the maximum number of these distances.
_STEP = 2
_MOST_REACHES = 12
# Vertices that are asked how many there are, before all are.
_ASKED = 4096
# A direction that edges and axes of models do not have, and neighbours along it that are looked at.
_SKEW = np.array([0.6180339887, 0.5346801132, 0.5763518722])
_MOST_STEPS = 32


def equal_sets(vertices: Vertices) -> NDArray[np.int32]:
    """Return the set of equal vertices each vertex is in, numbered from 0 in the order of first vertices."""
    return equal_positions(vertices)[0]


def joinable_sets(
    vertices: Vertices, triangles: Triangles, distance: float, copy_distance: float | None = None
) -> tuple[NDArray[np.int32], Vertices, NDArray[np.bool_]]:
    """Find the sets of similar vertices that can be joined (Feng, Ni and Luo 2012, section 2.1).

    Two vertices are similar if they are closer than `distance`, or a chain of such steps leads from one to
    the other. The ends of an edge are not similar for being close. Vertices of different positions are joined
    only if the surface around them stays a manifold and no vertex moves by more than `distance`. Where a part
    stands on another or sheets lie on each other, vertices are joined within a smaller distance, or not at
    all.

    Parameters
    ----------
    distance : metres, at least 0; 0 for equal positions.
    copy_distance : metres, vertices closer than this are copies of one vertex; None for `distance`.

    Returns
    -------
    sets : (n,) int32, the set of each vertex, numbered from 0 in the order of their first vertices.
    positions : (n, 3) float64, the mean position of each vertex's set; where all are equal, that to the bit.
    apart : (n,) bool, vertices that are not in one set with all their copies. Surfaces touch there, and come
        apart where only one of them moves.

    Raises
    ------
    UsageError
        If `distance` is so large that most of the mesh would be one.
    """
    equal, first = equal_positions(vertices)
    links, lengths = _links(vertices[first], equal, triangles, distance)
    if not len(links):
        return equal, vertices[first][equal], np.zeros(len(equal), bool)
    copies = sets = equal
    # Sets that cannot be joined within a distance stay as they are within the one before.
    for reach in _reaches(distance, copy_distance):
        chained = _chained(links[lengths <= reach], equal, len(first))
        if reach <= (distance if copy_distance is None else copy_distance):
            copies = chained
        sets = _without_touching(vertices, triangles, chained, sets, reach)
    pairs = np.unique(np.stack([copies, sets]), axis=1)
    apart = np.bincount(pairs[0], minlength=len(first))[copies] > 1
    return sets, _means(vertices, sets), apart


def _reaches(distance: float, copy_distance: float | None) -> list[float]:
    """Return the distances at which vertices are joined, from small to large."""
    if copy_distance is None or copy_distance >= distance:
        return [distance]
    steps = [distance / _STEP**power for power in range(_MOST_REACHES)]
    return [copy_distance, *sorted(step for step in steps if step > copy_distance)]


def _without_touching(
    vertices: Vertices, triangles: Triangles, sets: NDArray[np.int32], before: NDArray[np.int32], reach: float
) -> NDArray[np.int32]:
    """Return `sets` (n,), but those of `before` where surfaces touch that cannot be joined.

    Parameters
    ----------
    before : (n,) sets of which each one of `sets` has one or more.
    reach : metres that a vertex may move.
    """
    while True:
        # A set that is taken apart may leave its neighbours in a set that cannot be joined any more.
        pairs = np.unique(np.stack([sets, before]), axis=1)
        is_joined = np.bincount(pairs[0])[sets] > 1
        if not is_joined.any():
            return sets
        sheets = taken_apart(triangles, sets)
        is_refused = np.zeros(len(sets), bool)
        is_refused[sets[sheets.vertex_source[sheets.touches]]] = True
        offsets = _means(vertices, sets) - vertices
        is_refused[sets[(offsets * offsets).sum(axis=1) > reach * reach]] = True
        taken = is_joined & is_refused[sets]
        if not taken.any():
            return sets
        sets = rank_labels(np.where(taken, len(sets) + before, sets))


def may_have_equal(vertices: Vertices) -> bool:
    """Return False if all positions differ; in a tenth of the time that it takes to tell which are equal."""
    keys = np.sort(position_keys(vertices))
    return bool((keys[1:] == keys[:-1]).any())


def _links(
    positions: Vertices, equal: NDArray[np.int32], triangles: Triangles, distance: float
) -> tuple[NDArray[np.integer[Any]], NDArray[np.float64]]:
    """Return pairs (k, 2) of positions within `distance` that are no edges, and their lengths."""
    count = len(positions)
    if distance == 0 or count < 2:
        return np.empty((0, 2), np.int64), np.empty(0)
    pairs = _few_pairs(positions, distance)
    if pairs is None:
        pairs = _pairs_in_tree(positions, distance)
    if len(pairs):
        close = np.zeros(count, bool)
        close[pairs] = True
        edges = equal[triangles][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
        edges = np.sort(edges[close[edges].all(axis=1)], axis=1)
        pairs = np.sort(pairs, axis=1)
        pairs = pairs[~np.isin(pairs @ [count, 1], edges @ [count, 1])]
    return pairs, np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)


def _chained(links: NDArray[np.integer[Any]], equal: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """Return the set of each vertex that chains of links between `count` positions make."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(links), bool), (links[:, 0], links[:, 1])), shape=(count, count))
    return rank_labels(connected_components(graph, directed=False)[1][equal])


def _few_pairs(positions: Vertices, distance: float) -> NDArray[np.integer[Any]] | None:
    """Return the pairs (k, 2) no farther apart than `distance` if there are few to look at; else None.

    What is near in space is near along any line. Along one that no grid is aligned with, of vertices that are
    far apart hardly two are; sorting them is several times faster than building a tree.
    """
    along = positions @ _SKEW
    order = np.argsort(along)
    along = along[order]
    # What is lost to rounding in the product.
    reach = distance + 8 * np.finfo(np.float64).eps * float(np.abs(along).max())
    found: list[NDArray[np.integer[Any]]] = [np.empty((0, 2), np.int64)]
    for step in range(1, _MOST_STEPS):
        near = np.flatnonzero(along[step:] - along[:-step] <= reach)
        if not len(near):
            pairs = np.concatenate(found)
            offsets = positions[pairs[:, 0]] - positions[pairs[:, 1]]
            return np.asarray(pairs[(offsets * offsets).sum(axis=1) <= distance * distance])
        found.append(np.stack([order[near], order[near + step]], axis=1))
    return None


def _pairs_in_tree(positions: Vertices, distance: float) -> NDArray[np.integer[Any]]:
    """Return the pairs (k, 2) that are no farther apart than `distance`.

    Raises
    ------
    UsageError
        If there are so many that the distance must be a mistake.
    """
    from scipy.spatial import cKDTree

    tree, count = cKDTree(positions), len(positions)
    # Counting all pairs takes three times as long as listing the few there should be.
    some = positions[:: max(count // _ASKED, 1)]
    if tree.query_ball_point(some, distance, return_length=True).mean() > _MOST_PAIRS / 2:
        pairs_in_all = (int(tree.count_neighbors(tree, distance)) - count) // 2
        if pairs_in_all > _MOST_PAIRS * count:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "{distance:g} m is far more than the distance between vertices: {pairs_in_all:,} pairs of "
                "{count:,} vertices are closer",
                Where(parameter="seams.similar_distance"),
                remedy="give a smaller one.",
                distance=distance,
                pairs_in_all=pairs_in_all,
                count=count,
            )
    pairs: NDArray[np.integer[Any]] = tree.query_pairs(distance, output_type="ndarray")
    return pairs


def _means(vertices: Vertices, sets: NDArray[np.int32]) -> Vertices:
    size = np.bincount(sets)
    total = np.stack([np.bincount(sets, vertices[:, axis]) for axis in range(3)], axis=1)
    mean = (total / np.maximum(size, 1)[:, None])[sets]
    one = vertices[first_members(sets)]
    # A set of equal vertices keeps their position to the bit, which a mean need not.
    uneven = np.zeros(len(size), bool)
    np.logical_or.at(uneven, sets, (vertices != one[sets]).any(axis=1))
    return np.where(uneven[sets][:, None], mean, one[sets])
