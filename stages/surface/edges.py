"""Edges of a triangle list, and fans of triangles around vertices.

Halfedge `3 t + k` runs from corner k of triangle t to the next corner of that triangle. A corner and the
halfedge that leaves it share one index. The mesh need not be manifold: an edge can have any number of
triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.surface.mesh import Triangles

Ids = NDArray[np.integer[Any]]


@dataclass(frozen=True, eq=False)
class Edges:
    """Unique undirected edges, sorted by their vertices.

    Attributes
    ----------
    ends : (e, 2) vertex indices, the smaller one first.
    triangle_count : (e,) number of incident triangles.
    forward_count : (e,) number of incident halfedges that run from the smaller to the larger vertex.
    of_halfedge : (3 m,) edge index of each halfedge.
    halfedges : (3 m,) halfedge indices sorted by edge, then by index.
    start : (e,) offset of each edge's halfedges in `halfedges`; `count[i]` entries belong to edge i.
    """

    ends: Ids
    triangle_count: Ids
    forward_count: Ids
    of_halfedge: Ids
    halfedges: Ids
    start: Ids


def build_edges(triangles: Triangles, vertex_count: int) -> Edges:
    """Build the edges of triangles, which must not repeat a vertex."""
    # Meshes can have many million triangles: large arrays are released as soon as possible.
    tail, head = triangles.reshape(-1), np.roll(triangles, -1, axis=1).reshape(-1)
    is_forward = tail < head
    key = np.minimum(tail, head).astype(np.int64)
    key *= vertex_count
    key += np.maximum(tail, head)
    del head
    halfedges = np.argsort(key, kind="stable")
    key = key[halfedges]
    first = np.ones(len(key), bool)
    first[1:] = key[1:] != key[:-1]
    start = np.flatnonzero(first)
    ends = np.stack(np.divmod(key[start], max(vertex_count, 1)), axis=1)
    del key
    of_halfedge = np.empty(len(first), np.int64)
    of_halfedge[halfedges] = np.cumsum(first) - 1
    return Edges(
        ends=ends,
        triangle_count=np.diff(start, append=len(first)),
        forward_count=np.bincount(of_halfedge[is_forward], minlength=len(start)),
        of_halfedge=of_halfedge,
        halfedges=halfedges,
        start=start,
    )


def make_edge_keys(a: Ids, b: Ids) -> NDArray[np.int64]:
    """Return one integer per undirected edge, ordered by the smaller, then by the larger vertex."""
    return np.asarray(np.minimum(a, b).astype(np.int64) << 32 | np.maximum(a, b).astype(np.int64))


def is_known_key(keys: Ids, known: Ids) -> NDArray[np.bool_]:
    """Return a mask of the keys that occur in the ascending array `known`."""
    if not len(known):
        return np.zeros(keys.shape, bool)
    rows = np.searchsorted(known, keys)
    return np.asarray(known[np.minimum(rows, len(known) - 1)] == keys)


def step_to_next_corner(corner: Ids) -> Ids:
    """Return the next corner in the same triangle."""
    return np.where(corner % 3 == 2, corner - 2, corner + 1)


def pair_halfedges(edges: Edges, chosen: NDArray[np.bool_]) -> tuple[Ids, Ids]:
    """Return pairs of halfedges that share a chosen edge.

    An edge with k halfedges yields a chain of k - 1 pairs, which connects all of them.
    """
    follows = np.ones(len(edges.halfedges), bool)
    follows[edges.start] = False
    follows &= chosen[edges.of_halfedge[edges.halfedges]]
    second = np.flatnonzero(follows)
    return edges.halfedges[second - 1], edges.halfedges[second]


def label_components(node_count: int, a: Ids, b: Ids) -> tuple[int, Ids]:
    """Label the connected components of `node_count` nodes joined by the pairs (a, b).

    Labels are numbered in the order of each component's first node.

    Returns
    -------
    The number of components, and the label (node_count,) of each node.
    """
    return _kernels.label_components(node_count, a, b)


def label_fans(triangles: Triangles, a: Ids, b: Ids) -> Ids:
    """Label the fans: corners of a vertex that the joined halfedges (a, b) connect.

    The halfedges of a pair share an edge. They can run in the same or in opposite directions.
    """
    corners = triangles.reshape(-1)
    b_head = step_to_next_corner(b)
    against = corners[a] == corners[b_head]
    matching = np.concatenate((np.where(against, b_head, b), np.where(against, b, b_head)))
    del b_head
    return label_components(len(corners), np.concatenate((a, step_to_next_corner(a))), matching)[1]
