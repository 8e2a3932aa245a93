"""Hole filling by minimum-area triangulation.

Source: Barequet and Sharir, "Filling gaps in the boundary of a polyhedron", 1995: dynamic programming over
chains of the border loop. No vertex is added, so new triangles take the colours of the rim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Edges, Ids, build_edges, step_to_next_corner
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.topology import MAX_FLATNESS
from scanloom.stages.surface.tracked_mesh import TrackedMesh

# Time grows with the cube of the edge count: about one second for 500 edges.
_MAX_EDGES = 500
# Minimum cosine between the normals of a cap and of the rim triangles. A cap facing backwards would close the
# outer boundary of an open component. At the open end of a tube the cosine is 0; that is still a hole.
_MIN_FACING_COSINE = -0.5


@dataclass(frozen=True, eq=False)
class LoopCap:
    """Triangulated cap of a border loop.

    Attributes
    ----------
    loop : (k,) vertices of the border loop, in the direction of the cap.
    rim_triangles : (k,) triangle at each edge of the loop.
    triangles : (k − 2, 3) cap, as positions in `loop`.
    """

    loop: Ids
    rim_triangles: Ids
    triangles: Triangles


def fill_holes(
    traced: TrackedMesh, max_length: float = np.inf, max_extent: float = np.inf
) -> tuple[TrackedMesh, int]:
    """Fill small holes; return the mesh and the number of filled holes.

    Some loops stay open; see `find_caps`.

    Parameters
    ----------
    traced : mesh with its origin.
    max_length : maximum length of the border loop in metres.
    max_extent : exclusive limit of the bounding-box diagonal of the border loop in metres.
    """
    mesh = traced.mesh
    caps = find_caps(mesh, build_edges(mesh.triangles, len(mesh.vertices)), max_length, max_extent)
    if not caps:
        return traced, 0
    triangles = np.concatenate([cap.loop[cap.triangles] for cap in caps]).astype(np.int32)
    return traced.append_triangles(triangles), len(caps)


def find_caps(
    mesh: Mesh, edges: Edges, max_length: float = np.inf, max_extent: float = np.inf
) -> list[LoopCap]:
    """Find the caps of small holes.

    Some loops have none: outer boundaries of components, loops of more than 500 edges, and loops that share a
    vertex with another border loop. The same applies to loops that cannot be closed without non-manifold
    edges.

    Parameters
    ----------
    edges : edges of the mesh.
    max_length : maximum length of the border loop in metres.
    max_extent : exclusive limit of the bounding-box diagonal of the border loop in metres.
    """
    existing = find_border_chords(edges)
    caps = []
    for loop, rim_triangles in _trace_border_loops(mesh, edges):
        rim = mesh.vertices[loop]
        if np.linalg.norm(np.ptp(rim, axis=0)) >= max_extent or len(loop) > _MAX_EDGES:
            continue
        if np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1).sum() > max_length:
            continue
        if not _is_cap_facing_rim(mesh, mesh.triangles[rim_triangles], rim):
            continue
        cap = triangulate_loop(rim, loop, existing)
        if cap is not None:
            caps.append(LoopCap(loop, rim_triangles, cap))
    return caps


def find_border_chords(edges: Edges) -> set[tuple[int, int]]:
    """Return the edges between border vertices, smaller vertex first."""
    is_border = np.zeros(edges.ends.max(initial=-1) + 1, bool)
    is_border[edges.ends[edges.triangle_count == 1]] = True
    between = is_border[edges.ends].all(axis=1)
    return set(map(tuple, edges.ends[between].tolist()))


def triangulate_loop(rim: Vertices, loop: Ids, existing: set[tuple[int, int]]) -> Triangles | None:
    """Compute the minimum-area triangulation (k, 3) of a loop, as positions in the loop.

    Parameters
    ----------
    rim : (n, 3) positions of the loop's vertices, metres.
    loop : (n,) vertices of the loop.
    existing : vertex pairs that cannot become an edge, smaller vertex first; edges of the loop are excepted.

    Returns
    -------
    None if there is no such triangulation.
    """
    if len(loop) == 3:
        is_flat = np.isinf(_compute_doubled_areas(*rim))
        return None if is_flat else np.array([[0, 1, 2]], np.int32)
    return _triangulate_min_area(rim, _find_allowed_edges(loop, existing))


def _trace_border_loops(mesh: Mesh, edges: Edges) -> list[tuple[Ids, Ids]]:
    """Return the border loops with the triangles along each.

    A loop has the direction of a cap, opposite to the border halfedges.
    """
    corners = mesh.triangles.reshape(-1)
    border = edges.halfedges[edges.start[edges.triangle_count == 1]]
    # The halfedges of a cap run against the existing border halfedges.
    heads, tails = corners[step_to_next_corner(border)], corners[border]
    # At a vertex shared by several loops the continuation is ambiguous.
    _, position, times = np.unique(heads, return_inverse=True, return_counts=True)
    steps = zip(heads.tolist(), tails.tolist(), border.tolist(), times[position] == 1, strict=True)
    follower = {head: (tail, halfedge // 3) for head, tail, halfedge, is_clear in steps if is_clear}
    loops = []
    for first in sorted(follower):
        loop, rim_triangles = [], []
        vertex = first
        while vertex in follower:
            loop.append(vertex)
            vertex, triangle = follower.pop(vertex)
            rim_triangles.append(triangle)
        if loop and vertex == first:
            loops.append((np.array(loop), np.array(rim_triangles)))
    return loops


def _find_allowed_edges(loop: Ids, existing: set[tuple[int, int]]) -> NDArray[np.bool_]:
    """Return a mask of the vertex pairs of a loop that can become an edge.

    A pair that is already an edge elsewhere is excluded.
    """
    count = len(loop)
    allowed = np.ones((count, count), bool)
    for i, a in enumerate(loop.tolist()):
        for j, b in enumerate(loop.tolist()[i + 2 :], i + 2):
            if (min(a, b), max(a, b)) in existing and (i, j) != (0, count - 1):
                allowed[i, j] = False
    return allowed


def _triangulate_min_area(rim: Vertices, allowed: NDArray[np.bool_]) -> Triangles | None:
    """Compute the minimum-area triangulation (k, 3) of a loop.

    Indices are positions in `rim`. The result is None if no triangulation is allowed.
    """
    count = len(rim)
    cost = np.full((count, count), np.inf)
    middle = np.zeros((count, count), np.int64)
    cost[np.arange(count - 1), np.arange(1, count)] = 0
    for gap in range(2, count):
        i = np.arange(count - gap)[:, None]
        j = i + gap
        k = i + np.arange(1, gap)
        total = cost[i, k] + cost[k, j] + _compute_doubled_areas(rim[i], rim[k], rim[j])
        best = total.argmin(axis=1)
        cost[i[:, 0], j[:, 0]] = np.where(allowed[i[:, 0], j[:, 0]], total[i[:, 0], best], np.inf)
        middle[i[:, 0], j[:, 0]] = k[i[:, 0], best]
    if not np.isfinite(cost[0, count - 1]):
        return None
    triangles = []
    open_chains = [(0, count - 1)]
    while open_chains:
        first, last = open_chains.pop()
        if last - first < 2:
            continue
        between = int(middle[first, last])
        triangles.append((first, between, last))
        open_chains += [(first, between), (between, last)]
    return np.array(triangles, np.int32)


def _compute_doubled_areas(a: Vertices, b: Vertices, c: Vertices) -> NDArray[np.float64]:
    """Return twice the triangle areas; infinite for degenerate triangles, to exclude them."""
    ab, ac, bc = b - a, c - a, c - b
    doubled = np.linalg.norm(np.cross(ab, ac), axis=-1)
    squares = [(e * e).sum(axis=-1) for e in (ab, ac, bc)]
    longest = np.maximum(np.maximum(squares[0], squares[1]), squares[2])
    return np.where(doubled <= MAX_FLATNESS * longest, np.inf, doubled)


def _is_cap_facing_rim(mesh: Mesh, rim_triangles: Triangles, rim: Vertices) -> bool:
    """Return True if a cap of the rim (k, 3) faces the same way as the rim triangles.

    The sum of the cap's normals is the same for all triangulations.
    """
    offsets = rim - rim[0]
    cap_normal = np.cross(offsets, np.roll(offsets, -1, axis=0)).sum(axis=0)
    a, b, c = mesh.vertices[rim_triangles].transpose(1, 0, 2)
    rim_normal = np.cross(b - a, c - a).sum(axis=0)
    return bool(
        cap_normal @ rim_normal
        >= _MIN_FACING_COSINE * np.linalg.norm(cap_normal) * np.linalg.norm(rim_normal)
    )
