"""Stitching of coincident borders, and welding of close vertices."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.edges import Ids, build_edges, label_components, step_to_next_corner
from scanloom.stages.surface.mesh import Vertices
from scanloom.stages.surface.topology import has_repeated_vertex
from scanloom.stages.surface.tracked_mesh import TrackedMesh
from scanloom.stages.surface.welding import find_first_equal_rows


def stitch(traced: TrackedMesh) -> tuple[TrackedMesh, int]:
    """Join pairs of border edges at equal positions and in opposite directions.

    This connects surfaces along texture seams, and triangle soups. Sheets that only touch at a point, or
    along edges of more than two triangles, stay separate. The joined vertex keeps the colour of the first
    one.

    Returns
    -------
    The mesh, and the number of joined pairs of edges.
    """
    mesh = traced.mesh
    corners = mesh.triangles.reshape(-1)
    proper = np.flatnonzero(np.repeat(~has_repeated_vertex(mesh.triangles), 3))
    edges = build_edges(mesh.triangles, len(mesh.vertices))
    border = proper[edges.triangle_count[edges.of_halfedge[proper]] == 1]
    if len(border) == 0:
        return traced, 0
    place = _map_positions(
        mesh.vertices, np.unique(corners[np.concatenate((border, step_to_next_corner(border)))])
    )
    border = border[place[corners[border]] != place[corners[step_to_next_corner(border)]]]
    tail, head = corners[border], corners[step_to_next_corner(border)]
    low, high = np.minimum(place[tail], place[head]), np.maximum(place[tail], place[head])
    _, group, size = np.unique(low * len(place) + high, return_inverse=True, return_counts=True)
    forward = place[tail] < place[head]
    is_pair = (size == 2) & (np.bincount(group, forward, len(size)) == 1)
    order = np.argsort(group, kind="stable")
    order = order[is_pair[group[order]]]
    first, second = order[::2], order[1::2]
    _, labels = label_components(
        len(mesh.vertices),
        np.concatenate((tail[first], head[first])),
        np.concatenate((head[second], tail[second])),
    )
    _, representative = np.unique(labels, return_index=True)
    return traced.merge_vertices(representative[labels]), len(first)


def _map_positions(vertices: Vertices, chosen: Ids) -> Ids:
    """Map each selected vertex to the first selected vertex at its position."""
    place = np.arange(len(vertices))
    place[chosen] = chosen[find_first_equal_rows(list(vertices[chosen].T))]
    return place


def weld(traced: TrackedMesh, distance: float) -> TrackedMesh:
    """Merge vertices within `distance` metres of each other, transitively."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(traced.mesh.vertices).query_pairs(distance, output_type="ndarray")
    _, labels = label_components(len(traced.mesh.vertices), pairs[:, 0], pairs[:, 1])
    _, representative = np.unique(labels, return_index=True)
    return traced.merge_vertices(representative[labels])
