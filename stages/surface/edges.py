"""Edges of a triangle list, and which corners of a vertex hang together.

Halfedge `3 t + k` runs from corner k of triangle t to its next corner; a corner has the number of the
halfedge that leaves it. Both need no manifold: an edge may have any number of triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Triangles

Ids = NDArray[np.integer[Any]]


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges, in the order of their vertices.

    Attributes
    ----------
    ends : (e, 2) the smaller vertex first.
    count : (e,) number of triangles.
    forward : (e,) how many of them run from the smaller vertex to the larger.
    of_halfedge : (3 m,) edge of each halfedge.
    halfedges : (3 m,) sorted by edge, then by number; edge i has those from start[i] on, count[i] of them.
    """

    ends: Ids
    count: Ids
    forward: Ids
    of_halfedge: Ids
    halfedges: Ids
    start: Ids


def edges_of(triangles: Triangles, vertex_count: int) -> Edges:
    """Return the edges of triangles that repeat no vertex."""
    tail = triangles.reshape(-1).astype(np.int64)
    head = tail[next_corner(np.arange(len(tail)))]
    key = np.minimum(tail, head) * vertex_count + np.maximum(tail, head)
    halfedges = np.argsort(key, kind="stable")
    ordered = key[halfedges]
    first = np.ones(len(key), bool)
    first[1:] = ordered[1:] != ordered[:-1]
    start = np.flatnonzero(first)
    edge = np.cumsum(first) - 1
    of_halfedge = np.empty(len(key), np.int64)
    of_halfedge[halfedges] = edge
    return Edges(
        ends=np.stack(np.divmod(ordered[start], max(vertex_count, 1)), axis=1),
        count=np.diff(start, append=len(key)),
        forward=np.bincount(of_halfedge, tail < head, len(start)).astype(np.int64),
        of_halfedge=of_halfedge,
        halfedges=halfedges,
        start=start,
    )


def next_corner(corner: Ids) -> Ids:
    """Return the next corner of the same triangle."""
    return np.where(corner % 3 == 2, corner - 2, corner + 1)


def neighbours(edges: Edges, chosen: NDArray[np.bool_]) -> tuple[Ids, Ids]:
    """Return pairs of halfedges of the chosen edges: all of one edge, chained one to the next."""
    follows = np.ones(len(edges.halfedges), bool)
    follows[edges.start] = False
    follows &= chosen[edges.of_halfedge[edges.halfedges]]
    second = np.flatnonzero(follows)
    return edges.halfedges[second - 1], edges.halfedges[second]


def components(count: int, a: Ids, b: Ids) -> tuple[int, Ids]:
    """Label the connected components of `count` nodes joined by the pairs (a, b), in order of first node."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    graph = csr_matrix((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    number, labels = connected_components(graph, directed=False)
    return int(number), labels


def fans(triangles: Triangles, a: Ids, b: Ids) -> Ids:
    """Label the corners: those of one vertex get one label if the joined halfedges (a, b) connect them.

    Each pair of halfedges runs along one edge, in the same direction or against each other.
    """
    corners = triangles.reshape(-1)
    a_head, b_head = next_corner(a), next_corner(b)
    against = corners[a] == corners[b_head]
    _, labels = components(
        len(corners),
        np.concatenate((a, a_head)),
        np.concatenate((np.where(against, b_head, b), np.where(against, b, b_head))),
    )
    return labels
