"""Close small holes with the triangulation of least area.

Barequet and Sharir, "Filling gaps in the boundary of a polyhedron", 1995: dynamic programming over the
chains of the border loop. No vertex is added, so colours come from the rim.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Edges, Ids, edges_of, next_corner
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.topology import FLAT
from scanloom.stages.surface.traced import Traced

# The work grows with the cube of the number of edges: at this many, about a second.
_MOST_EDGES = 500
# A cap that faces the other way than the triangles around it closes a piece from behind: its outline is no
# hole. At the open end of a tube they stand at right angles, which is still a hole.
_FACING = -0.5


def fill_holes(traced: Traced, max_length: float = np.inf, max_extent: float = np.inf) -> tuple[Traced, int]:
    """Fill small holes; return the mesh and the number of holes filled.

    Outlines of components, loops of more than 500 edges and those that cannot be closed without breaking the
    manifold stay open. So do loops through a vertex where several border loops meet.

    Parameters
    ----------
    max_length : metres along the border loop.
    max_extent : metres, diagonal of the bounding box of the border loop; holes have to be smaller.
    """
    mesh = traced.mesh
    edges = edges_of(mesh.triangles, len(mesh.vertices))
    existing = set(map(tuple, edges.ends[np.isin(edges.ends, _border_vertices(edges)).all(axis=1)].tolist()))
    caps = []
    for loop, beside in _loops(mesh, edges):
        rim = mesh.vertices[loop]
        if np.linalg.norm(np.ptp(rim, axis=0)) >= max_extent or len(loop) > _MOST_EDGES:
            continue
        if np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1).sum() > max_length:
            continue
        cap = _least_area(rim, _allowed(loop, existing))
        if cap is not None and _faces_with(mesh, mesh.triangles[beside], loop[cap]):
            caps.append(loop[cap])
    if not caps:
        return traced, 0
    return traced.extend(np.concatenate(caps).astype(np.int32)), len(caps)


def _border_vertices(edges: Edges) -> Ids:
    return np.unique(edges.ends[edges.count == 1])


def _loops(mesh: Mesh, edges: Edges) -> list[tuple[Ids, Ids]]:
    """Return the border loops, in the direction in which a cap runs, and the triangles along each."""
    corners = mesh.triangles.reshape(-1)
    border = edges.halfedges[edges.start[edges.count == 1]]
    # A cap runs against the halfedges that are there.
    heads, tails = corners[next_corner(border)], corners[border]
    # Where several loops meet, nothing says which way each goes on.
    _, position, times = np.unique(heads, return_inverse=True, return_counts=True)
    steps = zip(heads.tolist(), tails.tolist(), border.tolist(), times[position] == 1, strict=True)
    follower = {head: (tail, halfedge // 3) for head, tail, halfedge, is_clear in steps if is_clear}
    loops = []
    for first in sorted(follower):
        loop, beside = [], []
        vertex = first
        while vertex in follower:
            loop.append(vertex)
            vertex, triangle = follower.pop(vertex)
            beside.append(triangle)
        if loop and vertex == first:
            loops.append((np.array(loop), np.array(beside)))
    return loops


def _allowed(loop: Ids, existing: set[tuple[int, int]]) -> NDArray[np.bool_]:
    """Return which pairs of the loop's vertices may become an edge: those that are none yet, and its own."""
    count = len(loop)
    allowed = np.ones((count, count), bool)
    for i, a in enumerate(loop.tolist()):
        for j, b in enumerate(loop.tolist()[i + 2 :], i + 2):
            if (min(a, b), max(a, b)) in existing and (i, j) != (0, count - 1):
                allowed[i, j] = False
    return allowed


def _least_area(rim: Vertices, allowed: NDArray[np.bool_]) -> Triangles | None:
    """Return triangles (k, 3) of rim positions that close the loop with least area; None if none do."""
    count = len(rim)
    cost = np.full((count, count), np.inf)
    middle = np.zeros((count, count), np.int64)
    cost[np.arange(count - 1), np.arange(1, count)] = 0
    for gap in range(2, count):
        i = np.arange(count - gap)[:, None]
        j = i + gap
        k = i + np.arange(1, gap)
        total = cost[i, k] + cost[k, j] + _areas(rim[i], rim[k], rim[j])
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


def _areas(a: Vertices, b: Vertices, c: Vertices) -> NDArray[np.float64]:
    """Return twice the areas; infinite for flat triangles, which a sound mesh must not have."""
    ab, ac, bc = b - a, c - a, c - b
    doubled = np.linalg.norm(np.cross(ab, ac), axis=-1)
    squares = [(e * e).sum(axis=-1) for e in (ab, ac, bc)]
    longest = np.maximum(np.maximum(squares[0], squares[1]), squares[2])
    return np.where(doubled <= FLAT * longest, np.inf, doubled)


def _faces_with(mesh: Mesh, beside: Triangles, cap: Triangles | Ids) -> bool:
    """Return whether the cap looks the same way as the triangles around it."""
    cap_normal, rim_normal = _normal_sum(mesh.vertices, cap), _normal_sum(mesh.vertices, beside)
    return bool(cap_normal @ rim_normal >= _FACING * np.linalg.norm(cap_normal) * np.linalg.norm(rim_normal))


def _normal_sum(vertices: Vertices, triangles: Triangles | Ids) -> NDArray[np.float64]:
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return np.asarray(np.cross(b - a, c - a).sum(axis=0))
