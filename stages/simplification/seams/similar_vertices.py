"""Geometrically similar vertices: duplicates within a file, and vertices of touching parts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.surface.equal_positions import (
    find_equal_positions,
    find_first_members,
    hash_positions,
    rank_labels,
)
from scanloom.stages.surface.mesh import Triangles, Vertices
from scanloom.stages.surface.sheet_decomposition import cut_into_sheets

# Average pairs per vertex above which `similar_distance` is rejected as a mistake.
_MAX_PAIRS_PER_VERTEX = 64
# Factor between the distances at which vertices are joined, and the maximum number of these distances.
_DISTANCE_STEP = 2
_MAX_DISTANCES = 12
# Vertices in the sample that estimates the number of pairs.
_SAMPLED_VERTICES = 4096
# Direction that is not aligned with edges and axes of typical models, and the neighbours along it to examine.
_SKEW_DIRECTION = np.array([0.6180339887, 0.5346801132, 0.5763518722])
_MAX_LINE_NEIGHBOURS = 32


def group_equal_vertices(vertices: Vertices) -> NDArray[np.int32]:
    """Group vertices (n,) at equal positions.

    Groups are numbered from 0 in the order of their first vertices.
    """
    return find_equal_positions(vertices)[0]


def group_joinable_vertices(
    vertices: Vertices, triangles: Triangles, distance: float, copy_distance: float | None = None
) -> tuple[NDArray[np.int32], Vertices, NDArray[np.bool_]]:
    """Group similar vertices that can be joined.

    The definition follows Feng, Ni and Luo 2012, section 2.1.

    Two vertices are similar if they are closer than `distance`, or connected by a chain of such pairs. The
    ends of an edge are never a pair. Joining vertices at different positions must keep the surface a
    manifold, and move no vertex by more than `distance`. Vertices where a part stands on another or sheets
    coincide are joined within a smaller distance, or not at all.

    Parameters
    ----------
    vertices, triangles : (n, 3) float64, metres, and (m, 3) int32.
    distance : metres, at least 0; 0 for equal positions.
    copy_distance : metres, vertices closer than this are duplicates; None for `distance`.

    Returns
    -------
    sets : (n,) int32, set of each vertex, numbered in the order of their first vertices.
    positions : (n, 3) float64, metres, mean position of each vertex's set; bit-identical if all are equal.
    apart : (n,) bool, vertices that are not joined with all their duplicates. Surfaces that touch there would
        separate if only one of them moved.

    Raises
    ------
    UsageError
        If `distance` would join most of the mesh.
    """
    equal, first = find_equal_positions(vertices)
    links, lengths = _find_links(vertices[first], equal, triangles, distance)
    if not len(links):
        return equal, vertices[first][equal], np.zeros(len(equal), bool)
    copies = sets = equal
    # Sets that cannot be joined at one distance keep the grouping of the previous, smaller distance.
    for reach in _list_join_distances(distance, copy_distance):
        chained = _group_chains(links[lengths <= reach], equal, len(first))
        if reach <= (distance if copy_distance is None else copy_distance):
            copies = chained
        sets = _split_touching_sets(vertices, triangles, chained, sets, reach)
    pairs = np.unique(np.stack([copies, sets]), axis=1)
    apart = np.bincount(pairs[0], minlength=len(first))[copies] > 1
    return sets, _average_sets(vertices, sets), apart


def _list_join_distances(distance: float, copy_distance: float | None) -> list[float]:
    """Return the distances at which vertices are joined, ascending, in metres."""
    if copy_distance is None or copy_distance >= distance:
        return [distance]
    steps = [distance / _DISTANCE_STEP**power for power in range(_MAX_DISTANCES)]
    return [copy_distance, *sorted(step for step in steps if step > copy_distance)]


def _split_touching_sets(
    vertices: Vertices,
    triangles: Triangles,
    sets: NDArray[np.int32],
    finer_sets: NDArray[np.int32],
    max_displacement: float,
) -> NDArray[np.int32]:
    """Revert sets to a finer grouping where touching surfaces cannot be joined.

    Parameters
    ----------
    sets : (n,) int32, set of each vertex.
    finer_sets : (n,) int32, finer grouping; each of `sets` is a union of its sets.
    max_displacement : metres, maximum displacement of a vertex.
    """
    while True:
        # Splitting a set may make the sets of its neighbours invalid, so repeat until nothing changes.
        pairs = np.unique(np.stack([sets, finer_sets]), axis=1)
        is_joined = np.bincount(pairs[0])[sets] > 1
        if not is_joined.any():
            return sets
        sheets = cut_into_sheets(triangles, sets)
        is_refused = np.zeros(len(sets), bool)
        is_refused[sets[sheets.vertex_source[sheets.is_contact]]] = True
        offsets = _average_sets(vertices, sets) - vertices
        is_refused[sets[(offsets * offsets).sum(axis=1) > max_displacement * max_displacement]] = True
        taken = is_joined & is_refused[sets]
        if not taken.any():
            return sets
        sets = rank_labels(np.where(taken, len(sets) + finer_sets, sets))


def has_possible_duplicates(vertices: Vertices) -> bool:
    """Return False if all positions differ.

    The test takes a tenth of the time of `find_equal_positions`.
    """
    keys = np.sort(hash_positions(vertices))
    return bool((keys[1:] == keys[:-1]).any())


def _find_links(
    positions: Vertices, equal: NDArray[np.int32], triangles: Triangles, distance: float
) -> tuple[NDArray[np.integer[Any]], NDArray[np.float64]]:
    """Find pairs (k, 2) of positions within `distance` that share no edge.

    Returns the pairs, and their distances in metres.
    """
    count = len(positions)
    if distance == 0 or count < 2:
        return np.empty((0, 2), np.int64), np.empty(0)
    pairs = _find_pairs_by_sorting(positions, distance)
    if pairs is None:
        pairs = _find_pairs_by_tree(positions, distance)
    if len(pairs):
        close = np.zeros(count, bool)
        close[pairs] = True
        edges = equal[triangles][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
        edges = np.sort(edges[close[edges].all(axis=1)], axis=1)
        pairs = np.sort(pairs, axis=1)
        pairs = pairs[~np.isin(pairs @ [count, 1], edges @ [count, 1])]
    return pairs, np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)


def _group_chains(links: NDArray[np.integer[Any]], equal: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """Group vertices (n,) that chains of links connect."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(links), bool), (links[:, 0], links[:, 1])), shape=(count, count))
    return rank_labels(connected_components(graph, directed=False)[1][equal])


def _find_pairs_by_sorting(positions: Vertices, distance: float) -> NDArray[np.integer[Any]] | None:
    """Find the pairs (k, 2) within `distance` by sorting along a line.

    Returns None if there are too many candidates.

    Points near each other are also near along any line. Few distant points coincide along a line that is not
    aligned with grids. Sorting is several times faster than building a tree.
    """
    along = positions @ _SKEW_DIRECTION
    order = np.argsort(along)
    along = along[order]
    # Add the rounding error of the dot product.
    reach = distance + 8 * np.finfo(np.float64).eps * float(np.abs(along).max())
    found: list[NDArray[np.integer[Any]]] = [np.empty((0, 2), np.int64)]
    for step in range(1, _MAX_LINE_NEIGHBOURS):
        near = np.flatnonzero(along[step:] - along[:-step] <= reach)
        if not len(near):
            pairs = np.concatenate(found)
            offsets = positions[pairs[:, 0]] - positions[pairs[:, 1]]
            return np.asarray(pairs[(offsets * offsets).sum(axis=1) <= distance * distance])
        found.append(np.stack([order[near], order[near + step]], axis=1))
    return None


def _find_pairs_by_tree(positions: Vertices, distance: float) -> NDArray[np.integer[Any]]:
    """Find the pairs (k, 2) within `distance` with a k-d tree.

    Raises
    ------
    UsageError
        If there are too many pairs for a plausible distance.
    """
    from scipy.spatial import cKDTree

    tree, count = cKDTree(positions), len(positions)
    # Counting all pairs takes three times as long as listing few, so a sample is tested first.
    some = positions[:: max(count // _SAMPLED_VERTICES, 1)]
    if tree.query_ball_point(some, distance, return_length=True).mean() > _MAX_PAIRS_PER_VERTEX / 2:
        pairs_in_all = (int(tree.count_neighbors(tree, distance)) - count) // 2
        if pairs_in_all > _MAX_PAIRS_PER_VERTEX * count:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {distance:g} m, far more than the distance between vertices: "
                "{pairs_in_all:,} pairs of {count:,} vertices are closer",
                DiagnosticLocation(parameter="seams.similar_distance"),
                remedy="give a smaller value.",
                distance=distance,
                pairs_in_all=pairs_in_all,
                count=count,
            )
    pairs: NDArray[np.integer[Any]] = tree.query_pairs(distance, output_type="ndarray")
    return pairs


def _average_sets(vertices: Vertices, sets: NDArray[np.int32]) -> Vertices:
    size = np.bincount(sets)
    total = np.stack([np.bincount(sets, vertices[:, axis]) for axis in range(3)], axis=1)
    mean = (total / np.maximum(size, 1)[:, None])[sets]
    one = vertices[find_first_members(sets)]
    # Sets of equal vertices keep their exact position, which a mean may not.
    uneven = np.zeros(len(size), bool)
    np.logical_or.at(uneven, sets, (vertices != one[sets]).any(axis=1))
    return np.where(uneven[sets][:, None], mean, one[sets])
