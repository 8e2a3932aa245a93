"""Geometrically similar vertices: copies that files make of one, and parts that touch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import UsageError
from stages.mesh import Triangles, Vertices

# Pairs a vertex may have on average before `similar_distance` is taken for a mistake.
_MOST_PAIRS = 64

# Share of the bounding box's diagonal that counts as equal: what single precision leaves of a coordinate.
_EQUAL = 1e-6


def default_similar_distance(vertices: Vertices) -> float:
    """Return the distance within which vertices of a mesh are the same, in its own unit.

    A millionth of the bounding box's diagonal, about what is lost where a file holds single precision.
    """
    return _EQUAL * float(np.linalg.norm(np.ptp(vertices, axis=0))) if len(vertices) else 0.0


def similar_sets(
    vertices: Vertices, triangles: Triangles, distance: float
) -> tuple[NDArray[np.int32], Vertices]:
    """Find the sets of similar vertices (Feng, Ni and Luo 2012, section 2.1).

    Two vertices are similar if they are closer than `distance`, or a chain of such steps leads from one to the
    other. The ends of an edge are not similar for being close.

    Parameters
    ----------
    distance : metres, at least 0; 0 for equal positions.

    Returns
    -------
    sets : (n,) int32, the set of each vertex, numbered from 0 in the order of their first vertices.
    positions : (n, 3) float64, the mean position of each vertex's set; where all are equal, that to the bit.

    Raises
    ------
    UsageError
        If `distance` is so large that most of the mesh would be one.
    """
    positions, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    label: NDArray[Any] = inverse.reshape(-1)
    if distance > 0 and len(positions) > 1:
        label = _joined(positions, label[triangles], distance)[label]
    found, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(found), np.int64)
    rank[np.argsort(first)] = np.arange(len(found))
    sets = rank[inverse.reshape(-1)].astype(np.int32)
    return sets, _means(vertices, sets)


def _joined(positions: Vertices, triangles: NDArray[Any], distance: float) -> NDArray[Any]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    tree, count = cKDTree(positions), len(positions)
    pairs_in_all = (int(tree.count_neighbors(tree, distance)) - count) // 2
    if pairs_in_all > _MOST_PAIRS * count:
        raise UsageError(
            f"similar_distance {distance:g} m is far more than the distance between vertices: "
            f"{pairs_in_all:,} pairs of {count:,} vertices are closer; give a smaller one."
        )
    pairs = tree.query_pairs(distance, output_type="ndarray")
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    pairs = pairs[~np.isin(pairs @ [count, 1], edges @ [count, 1])]
    links = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1])


def _means(vertices: Vertices, sets: NDArray[np.int32]) -> Vertices:
    size = np.bincount(sets)
    total = np.stack([np.bincount(sets, vertices[:, axis]) for axis in range(3)], axis=1)
    mean = (total / np.maximum(size, 1)[:, None])[sets]
    one = np.empty((len(size), 3))
    one[sets[::-1]] = vertices[::-1]
    # A set of equal vertices keeps their position to the bit, which a mean need not.
    uneven = np.zeros(len(size), bool)
    np.logical_or.at(uneven, sets, (vertices != one[sets]).any(axis=1))
    return np.where(uneven[sets][:, None], mean, one[sets])
