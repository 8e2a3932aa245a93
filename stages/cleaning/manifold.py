"""Conversion of any triangle set to an oriented manifold.

Triangles are flipped so that neighbours are oriented consistently. At most two triangles are linked at each
edge. Each vertex is then split into one vertex per fan of linked corners. Touching sheets are separated
without removing triangles. The only exception is an edge at which two sheets stay connected at both ends: its
smallest triangle is removed. Vertex splitting follows Guéziec, Taubin, Lazarus and Horn, "Cutting and
stitching", 2001.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import (
    Edges,
    Ids,
    build_edges,
    label_components,
    label_fans,
    pair_halfedges,
    step_to_next_corner,
)
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.surface.tracked_mesh import TrackedMesh

# Edges with more triangles are split without pairing triangles, because the number of candidate pairs grows
# quadratically.
_MAX_MATCHED_TRIANGLES = 32


@dataclass(frozen=True, eq=False)
class ManifoldResult:
    """Oriented manifold, with counts of flipped triangles, added vertices and removed triangles."""

    traced: TrackedMesh
    flipped_count: int
    split_vertex_count: int
    removed_count: int


def make_manifold(traced: TrackedMesh) -> ManifoldResult:
    """Make the surface an oriented manifold.

    No triangle of the input may use a vertex twice or duplicate another triangle.
    """
    flipped = split_vertices = removed = 0
    while True:
        count = len(traced.mesh.vertices)
        edges = build_edges(traced.mesh.triangles, count)
        flip = _select_flips(edges, len(traced.mesh.triangles))
        if flip.any():
            traced = traced.flip(flip)
            edges = build_edges(traced.mesh.triangles, count)
            flipped += np.count_nonzero(flip)
        is_sound = (
            not (edges.triangle_count > 2).any()
            and not ((edges.triangle_count == 2) & (edges.forward_count != 1)).any()
        )
        links = _find_links(traced.mesh, edges)
        del edges
        traced = traced.split_fans(label_fans(traced.mesh.triangles, *links))
        split_vertices += len(traced.mesh.vertices) - count
        is_invalid = np.zeros(0, bool) if is_sound else _find_invalid_triangles(traced.mesh)
        if not is_invalid.any():
            return ManifoldResult(traced, int(flipped), split_vertices, int(removed))
        removed += np.count_nonzero(is_invalid)
        traced = traced.keep(~is_invalid)


def _select_flips(edges: Edges, count: int) -> NDArray[np.bool_]:
    """Select the triangles (m,) to flip so that neighbours agree.

    A sheet is a component connected by edges of exactly two triangles; as few triangles as possible are
    flipped per sheet. A sheet is orientable if its orientation double cover has two components. On a
    non-orientable sheet, such as a Möbius strip, neighbours disagree along a seam.
    """
    a, b = (halfedge // 3 for halfedge in pair_halfedges(edges, edges.triangle_count == 2))
    differ = edges.forward_count[edges.triangle_count == 2] != 1
    if not differ.any():
        return np.zeros(count, bool)
    _, labels = label_components(
        2 * count,
        np.concatenate((a, a + count)),
        np.concatenate((np.where(differ, b + count, b), np.where(differ, b, b + count))),
    )
    side, other_side = labels[:count], labels[count:]
    flip = side > other_side
    sheet = np.minimum(side, other_side)
    one_sided = side == other_side
    if one_sided.any():
        inside = one_sided[a]
        parity = _compute_tree_parity(count, a[inside], b[inside], differ[inside], one_sided, sheet)
        left = np.bincount(sheet[a], (parity[a] ^ parity[b]) != differ, 2 * count)
        as_is = np.bincount(sheet[a], differ, 2 * count)
        better = (left < as_is)[sheet]
        flip = np.where(one_sided, parity & better, flip)
    turned = np.bincount(sheet, flip, 2 * count)
    return np.asarray(flip ^ (2 * turned > np.bincount(sheet, minlength=2 * count))[sheet])


def _compute_tree_parity(
    count: int, a: Ids, b: Ids, differ: NDArray[np.bool_], chosen: NDArray[np.bool_], sheet: Ids
) -> NDArray[np.bool_]:
    """Select triangles (m,) to flip so that neighbours are oriented consistently.

    Each sheet has a breadth-first spanning tree. After the flips, all neighbours along its edges agree.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import breadth_first_order

    # Two triangles may share several edges; the tree uses the first.
    _, first = np.unique(np.minimum(a, b) * count + np.maximum(a, b), return_index=True)
    a, b, differ = a[first], b[first], differ[first]
    members = np.flatnonzero(chosen)
    _, roots = np.unique(sheet[members], return_index=True)
    root = members[roots]
    # An extra root node connects all sheets, so that one search visits all of them.
    rows, columns = np.concatenate((a, root)), np.concatenate((b, np.full(len(root), count)))
    weights = np.concatenate((1 + differ, np.ones(len(root))))
    graph = csr_matrix((weights, (rows, columns)), shape=(count + 1, count + 1))
    graph = graph + graph.T
    order, before = breadth_first_order(graph, count, directed=False)
    parity = np.zeros(count + 1, bool)
    ancestor = np.full(count + 1, count, np.int64)
    nodes = order[1:]
    ancestor[nodes] = before[nodes]
    parity[nodes] = np.asarray(graph[nodes, before[nodes]]).reshape(-1) == 2
    while (ancestor != count).any():
        parity ^= parity[ancestor]
        ancestor = ancestor[ancestor]
    return parity[:count]


def _find_links(mesh: Mesh, edges: Edges) -> tuple[Ids, Ids]:
    """Return the pairs of halfedges to link.

    Regular edges link their two halfedges. Non-manifold edges link the flattest pairs.
    """
    a, b = pair_halfedges(edges, (edges.triangle_count == 2) & (edges.forward_count == 1))
    crowded = np.flatnonzero((edges.triangle_count > 2) & (edges.triangle_count <= _MAX_MATCHED_TRIANGLES))
    pairs = [pair for edge in crowded.tolist() for pair in _match_flattest_pairs(mesh, edges, edge)]
    more = np.array(pairs, np.int64).reshape(-1, 2)
    return np.concatenate((a, more[:, 0])), np.concatenate((b, more[:, 1]))


def _match_flattest_pairs(mesh: Mesh, edges: Edges, edge: int) -> list[tuple[int, int]]:
    """Pair consistently oriented triangles at an edge, flattest pair first."""
    start = edges.start[edge]
    halfedges = edges.halfedges[start : start + edges.triangle_count[edge]]
    corners = mesh.triangles.reshape(-1)
    tail, head = mesh.vertices[edges.ends[edge]]
    opposite = mesh.vertices[corners[step_to_next_corner(step_to_next_corner(halfedges))]]
    along = (head - tail) / np.linalg.norm(head - tail)
    away = opposite - tail
    away -= np.outer(away @ along, along)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    forward = corners[halfedges] == edges.ends[edge, 0]
    flatness = -away[forward] @ away[~forward].T
    ones, others = halfedges[forward], halfedges[~forward]
    pairs = []
    while flatness.size and flatness.max() > -np.inf:
        i, j = np.unravel_index(flatness.argmax(), flatness.shape)
        pairs.append((int(ones[i]), int(others[j])))
        flatness[i], flatness[:, j] = -np.inf, -np.inf
    return pairs


def _find_invalid_triangles(mesh: Mesh) -> NDArray[np.bool_]:
    """Select the smallest triangle at each edge that is still invalid.

    Invalid edges are non-manifold or have inconsistent triangles. The result is a mask (m,).
    """
    edges = build_edges(mesh.triangles, len(mesh.vertices))
    bad = (edges.triangle_count > 2) | ((edges.triangle_count == 2) & (edges.forward_count != 1))
    offenders = np.zeros(len(mesh.triangles), bool)
    for edge in np.flatnonzero(bad).tolist():
        start = edges.start[edge]
        candidates = edges.halfedges[start : start + edges.triangle_count[edge]] // 3
        offenders[candidates[compute_areas(mesh.vertices, mesh.triangles[candidates]).argmin()]] = True
    return offenders
