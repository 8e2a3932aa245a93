"""Join borders that lie on each other."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.edges import Ids, components, edges_of, next_corner
from scanloom.stages.surface.mesh import Vertices
from scanloom.stages.surface.topology import repeats_vertex
from scanloom.stages.surface.traced import Traced
from scanloom.stages.surface.welding import same_rows


def stitch(traced: Traced) -> tuple[Traced, int]:
    """Unite the ends of border edges that lie exactly on each other and run in opposite directions.

    So the seams of textured files and soups of single triangles become one surface, while sheets that
    touch in a point or run together along an edge stay as they are. The first vertex gives the colour.

    Returns
    -------
    The mesh, and the number of pairs of edges that were joined.
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
    """Return for each chosen vertex the first chosen one at its position."""
    place = np.arange(len(vertices))
    place[chosen] = chosen[same_rows(list(vertices[chosen].T))]
    return place


def weld(traced: Traced, distance: float) -> Traced:
    """Unite vertices no farther apart than `distance` metres, chains of them included."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(traced.mesh.vertices).query_pairs(distance, output_type="ndarray")
    _, labels = components(len(traced.mesh.vertices), pairs[:, 0], pairs[:, 1])
    _, representative = np.unique(labels, return_index=True)
    return traced.unite(representative[labels])
