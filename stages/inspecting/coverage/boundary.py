"""Boundary edges of a surface that is processed in batches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanloom.stages.inspecting.coverage.depth_view import Floats
from scanloom.stages.inspecting.coverage.probes import Ids
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, SingleChunkMesh
from scanloom.stages.surface.edges import build_edges, step_to_next_corner


@dataclass(frozen=True, eq=False)
class SurfaceBoundary:
    """Boundary edges (edges with one triangle), sorted by their vertices.

    Attributes
    ----------
    tails, heads : (k,) global vertex indices, in the direction of the triangle's halfedge.
    starts, ends : (k, 3) float64, their positions in metres, in mesh coordinates.
    normal_sums : (k, 3) sum of the two vertex normals.
    triangle_normals : (k, 3) normal of the adjacent triangle; its length is twice the triangle's area, m².
    """

    tails: Ids
    heads: Ids
    starts: Floats
    ends: Floats
    normal_sums: Floats
    triangle_normals: Floats


def find_boundary(surface: ChunkedMesh | SingleChunkMesh) -> SurfaceBoundary:
    """Find the boundary edges of an oriented manifold."""
    found = []
    for piece in surface.iterate_batches(with_normals=True):
        assert piece.normals is not None
        mesh = piece.mesh
        edges = build_edges(mesh.triangles, len(mesh.vertices))
        border = edges.halfedges[edges.start[edges.triangle_count == 1]]
        corners = mesh.triangles.reshape(-1)
        tails, heads = corners[border], corners[step_to_next_corner(border)]
        a, b, c = mesh.vertices[mesh.triangles[border // 3]].transpose(1, 0, 2)
        facing = piece.normals[tails].astype(np.float64) + piece.normals[heads]
        numbers = piece.global_indices[tails], piece.global_indices[heads]
        found.append((*numbers, mesh.vertices[tails], mesh.vertices[heads], facing, np.cross(b - a, c - a)))
    columns = [np.concatenate(column) for column in zip(*found, strict=True)]
    low, high = np.minimum(*columns[:2]), np.maximum(*columns[:2])
    order = np.lexsort((high, low))
    # An edge between two batches is a boundary edge in both.
    is_same = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
    is_inner = np.concatenate([is_same, [False]]) | np.concatenate([[False], is_same])
    return SurfaceBoundary(*(column[order[~is_inner]] for column in columns))
