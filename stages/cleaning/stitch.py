"""Stitching of coincident borders, and welding of close vertices."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.edges import Ids, components, edges_of, next_corner
from scanloom.stages.surface.mesh import Vertices
from scanloom.stages.surface.topology import repeats_vertex
from scanloom.stages.surface.traced import Traced
from scanloom.stages.surface.welding import same_rows


def stitch(traced: Traced) -> tuple[Traced, int]:
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
    proper = np.flatnonzero(np.repeat(~repeats_vertex(mesh.triangles), 3))
    edges = edges_of(mesh.triangles, len(mesh.vertices))
    border = proper[edges.count[edges.of_halfedge[proper]] == 1]
    if len(border) == 0:
        return traced, 0
    place = _places(mesh.vertices, np.unique(corners[np.concatenate((border, next_corner(border)))]))
    border = border[place[corners[border]] != place[corners[next_corner(border)]]]
    tail, head = corners[border], corners[next_corner(border)]
    low, high = np.minimum(place[tail], place[head]), np.maximum(place[tail], place[head])
    _, group, size = np.unique(low * len(place) + high, return_inverse=True, return_counts=True)
    forward = place[tail] < place[head]
    alone = (size == 2) & (np.bincount(group, forward, len(size)) == 1)
    order = np.argsort(group, kind="stable")
    order = order[alone[group[order]]]
    first, second = order[::2], order[1::2]
    _, labels = components(
        len(mesh.vertices),
        np.concatenate((tail[first], head[first])),
        np.concatenate((head[second], tail[second])),
    )
    _, representative = np.unique(labels, return_index=True)
    return traced.unite(representative[labels]), len(first)


def _places(vertices: Vertices, chosen: Ids) -> Ids:
    """Map each selected vertex to the first selected vertex at its position."""
    place = np.arange(len(vertices))
    place[chosen] = chosen[same_rows(list(vertices[chosen].T))]
    return place


def weld(traced: Traced, distance: float) -> Traced:
    """Merge vertices within `distance` metres of each other, transitively."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(traced.mesh.vertices).query_pairs(distance, output_type="ndarray")
    _, labels = components(len(traced.mesh.vertices), pairs[:, 0], pairs[:, 1])
    _, representative = np.unique(labels, return_index=True)
    return traced.unite(representative[labels])
