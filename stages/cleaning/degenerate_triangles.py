r"""Removal of degenerate triangles without opening cracks.

A degenerate triangle is a needle, with one edge of zero length, or a cap, with a vertex on its longest edge.
The short edge of a needle is collapsed. Removing a cap would leave a T-junction on the neighbour's edge, so
the neighbour is split instead:

        w                      w
       / \                    /|\
      /   \                  / | \
     p-----q       →        p--v--q
      `-v-'
"""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.edges import Ids, build_edges, label_components
from scanloom.stages.surface.mesh import Triangles, Vertices
from scanloom.stages.surface.topology import MAX_FLATNESS, has_repeated_vertex, is_degenerate
from scanloom.stages.surface.tracked_mesh import TrackedMesh

# Maximum iterations, each of which removes one layer of degenerate triangles. Scans need two. Stacks of
# collinear triangles that remain are deleted.
_MAX_ITERATIONS = 32


def remove_degenerate(traced: TrackedMesh) -> TrackedMesh:
    """Remove triangles that use a vertex twice or have no area."""
    for _ in range(_MAX_ITERATIONS):
        traced = traced.keep(~has_repeated_vertex(traced.mesh.triangles))
        flat = np.flatnonzero(is_degenerate(traced.mesh.vertices, traced.mesh.triangles))
        if len(flat) == 0:
            return traced
        representative = _map_short_edges(traced, flat)
        if representative is not None:
            traced = traced.merge_vertices(representative)
        else:
            traced = _split_neighbours(traced, flat)
    return traced.keep(~is_degenerate(traced.mesh.vertices, traced.mesh.triangles))


def _map_short_edges(traced: TrackedMesh, flat: Ids) -> Ids | None:
    """Map each vertex to its representative after collapsing all short edges.

    Returns
    -------
    (n,) representative of each vertex; None if there is no short edge.
    """
    triangles = traced.mesh.triangles[flat]
    lengths = _compute_edge_lengths(traced.mesh.vertices, triangles)
    short = lengths <= MAX_FLATNESS * lengths.max(axis=1, keepdims=True)
    if not short.any():
        return None
    tails, heads = triangles[short], np.roll(triangles, -1, axis=1)[short]
    _, labels = label_components(len(traced.mesh.vertices), tails, heads)
    _, first = np.unique(labels, return_index=True)
    return np.asarray(first[labels])


def _split_neighbours(traced: TrackedMesh, flat: Ids) -> TrackedMesh:
    """Split the neighbour across the longest edge of each cap.

    Of caps that share a neighbour, only the first is processed in this iteration.
    """
    triangles = traced.mesh.triangles.astype(np.int64)
    count = len(triangles)
    edges = build_edges(traced.mesh.triangles, len(traced.mesh.vertices))
    longest = _compute_edge_lengths(traced.mesh.vertices, triangles[flat]).argmax(axis=1)
    halfedge = 3 * flat + longest
    edge = edges.of_halfedge[halfedge]
    paired = edges.triangle_count[edge] == 2
    # A border cap leaves no T-junction when it is deleted. Caps at edges of three or more triangles are
    # deleted too, because such edges are split later anyway.
    keep = np.ones(count, bool)
    keep[flat[~paired]] = False

    cap, halfedge, edge = flat[paired], halfedge[paired], edge[paired]
    start = edges.start[edge]
    other = edges.halfedges[start] + edges.halfedges[start + 1] - halfedge
    neighbour = other // 3
    claim = np.full(count, count)
    np.minimum.at(claim, cap, cap)
    np.minimum.at(claim, neighbour, cap)
    first = (claim[cap] == cap) & (claim[neighbour] == cap)
    cap, neighbour, other, halfedge = cap[first], neighbour[first], other[first], halfedge[first]

    v = triangles[cap, (halfedge % 3 + 2) % 3]
    columns = (other[:, None] % 3 + np.arange(3)) % 3
    p, q, w = np.take_along_axis(triangles[neighbour], columns, axis=1).T
    mesh = traced.mesh
    share = _compute_split_ratio(mesh.vertices, p, q, v)
    split = (cap, neighbour, columns, share)
    uvs = None if mesh.texture is None else _split_corners(mesh.texture.uvs, *split)
    corner_normals = None
    if mesh.corner_normals is not None:
        corner_normals = _split_corners(mesh.corner_normals, *split, unit=True)
    triangles[neighbour] = np.stack((p, v, w), axis=1)
    triangles[cap] = np.stack((v, q, w), axis=1)
    origin = np.arange(count)
    origin[cap] = neighbour
    return traced.replace_triangles(triangles.astype(np.int32), origin, uvs, corner_normals).keep(keep)


def _split_corners(
    values: Vertices, cap: Ids, neighbour: Ids, columns: Ids, split_ratio: Vertices, *, unit: bool = False
) -> Vertices:
    """Interpolate corner attributes for the two triangles after the split.

    The value at v is interpolated linearly between the values at p and q, and normalised if `unit` is set.
    """
    values = values.copy()
    corner = np.take_along_axis(values[neighbour], columns[..., None], axis=1)
    middle = corner[:, 0] * (1 - split_ratio) + corner[:, 1] * split_ratio
    if unit:
        length = np.linalg.norm(middle, axis=-1, keepdims=True)
        middle /= np.where(length == 0, 1, length)
    values[neighbour] = np.stack((corner[:, 0], middle, corner[:, 2]), axis=1)
    values[cap] = np.stack((middle, corner[:, 1], corner[:, 2]), axis=1)
    return values


def _compute_split_ratio(vertices: Vertices, p: Ids, q: Ids, v: Ids) -> Vertices:
    """Compute the position (k, 1) of v between p (0) and q (1)."""
    from_p = np.linalg.norm(vertices[v] - vertices[p], axis=1, keepdims=True)
    from_q = np.linalg.norm(vertices[v] - vertices[q], axis=1, keepdims=True)
    return np.asarray(from_p / (from_p + from_q))


def _compute_edge_lengths(vertices: Vertices, triangles: Triangles | Ids) -> Vertices:
    """Compute the edge lengths (m, 3) of triangles.

    Column 0 is the edge from corner 0 to corner 1.
    """
    corners = vertices[triangles]
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))
