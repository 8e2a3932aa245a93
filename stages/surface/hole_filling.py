"""Hole filling by minimum-area triangulation.

No vertex is added, so new triangles take the colours of the rim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Edges, Ids, build_edges, make_edge_keys, step_to_next_corner
from scanloom.stages.surface.loop_triangulation import triangulate_loops
from scanloom.stages.surface.mesh import Mesh, Triangles
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
    triangles : (k − 2, 3) cap, as positions in `loop`.
    """

    loop: Ids
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
    loops, rim_triangles = trace_border_loops(mesh, edges)
    kept = [row for row in range(len(loops)) if len(loops[row]) <= _MAX_EDGES]
    if kept:
        is_small = _mask_holes(
            mesh, [loops[row] for row in kept], [rim_triangles[row] for row in kept], max_length, max_extent
        )
        kept = [row for row, small in zip(kept, is_small, strict=True) if small]
    caps = triangulate_loops(mesh.vertices, [loops[row] for row in kept], _find_border_chords(edges))
    return [LoopCap(loops[row], cap) for row, cap in zip(kept, caps, strict=True) if cap is not None]


def _find_border_chords(edges: Edges) -> Ids:
    """Return the keys of the edges between border vertices, ascending."""
    is_border = np.zeros(int(edges.ends.max(initial=-1)) + 1, bool)
    is_border[edges.ends[edges.triangle_count == 1]] = True
    first, second = edges.ends.T
    between = is_border[first] & is_border[second]
    return make_edge_keys(first[between], second[between])


def trace_border_loops(mesh: Mesh, edges: Edges) -> tuple[list[Ids], list[Ids]]:
    """Return the vertices of the border loops, and the triangles along each.

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
    loops, rim_triangles = [], []
    for first in sorted(follower):
        loop, triangles = [], []
        vertex = first
        while vertex in follower:
            loop.append(vertex)
            vertex, triangle = follower.pop(vertex)
            triangles.append(triangle)
        if loop and vertex == first:
            loops.append(np.array(loop))
            rim_triangles.append(np.array(triangles))
    return loops, rim_triangles


def _mask_holes(
    mesh: Mesh, loops: Sequence[Ids], rim_triangles: Sequence[Ids], max_length: float, max_extent: float
) -> NDArray[np.bool_]:
    """Return a mask of the loops that are small enough, and are not the outer boundary of a component."""
    lengths = np.array([len(loop) for loop in loops])
    ends = np.cumsum(lengths)
    starts = ends - lengths
    following = np.arange(1, ends[-1] + 1)
    following[ends - 1] = starts
    rims = mesh.vertices[np.concatenate(loops)]
    extents = np.linalg.norm(np.maximum.reduceat(rims, starts) - np.minimum.reduceat(rims, starts), axis=1)
    perimeters = np.add.reduceat(np.linalg.norm(rims[following] - rims, axis=1), starts)
    # The sum of a cap's normals is the same for all triangulations.
    offsets = rims - np.repeat(rims[starts], lengths, axis=0)
    cap_normals = np.add.reduceat(np.cross(offsets, offsets[following]), starts)
    a, b, c = mesh.vertices[mesh.triangles[np.concatenate(rim_triangles)]].transpose(1, 0, 2)
    rim_normals = np.add.reduceat(np.cross(b - a, c - a), starts)
    limits = _MIN_FACING_COSINE * np.linalg.norm(cap_normals, axis=1) * np.linalg.norm(rim_normals, axis=1)
    is_facing = (cap_normals * rim_normals).sum(axis=1) >= limits
    return np.asarray((extents < max_extent) & (perimeters <= max_length) & is_facing)
