"""Signed distances from an oriented surface by angle-weighted pseudonormals.

Bærentzen and Aanæs, "Signed distance computation using the angle weighted pseudonormal", 2005. Distances are
positive in front of the surface. If the nearest point is on an edge or a vertex, the normal of a single
triangle can give the wrong sign. The angle-weighted sum of the adjacent normals always gives the correct sign
on a closed surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Edges, build_edges
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import (
    ClosestPoints,
    Floats,
    compute_triangle_normals,
    interpolate_values,
)
from scanloom.stages.surface.topology import has_repeated_vertex, is_inconsistent

# Barycentric weight below which a point is on the edge opposite to the corner.
_MIN_BARYCENTRIC_WEIGHT = 1e-6


class Pseudonormals:
    """Pseudonormals of triangles, edges and vertices for signed distances.

    Parameters
    ----------
    mesh : oriented mesh. Points beyond its border get the sign of the border's pseudonormal.
    edges : edges of its triangles without repeated vertices, if known.
    """

    def __init__(self, mesh: Mesh, edges: Edges | None = None) -> None:
        self._mesh = mesh
        self._triangle_normals = compute_triangle_normals(mesh)
        self._vertex_normals = _sum_angle_weighted_normals(mesh, self._triangle_normals)
        kept = ~has_repeated_vertex(mesh.triangles)
        edges = edges or build_edges(mesh.triangles[kept], len(mesh.vertices))
        sums = self._edge_normals = np.zeros((len(edges.ends), 3))
        owners = np.repeat(np.flatnonzero(kept), 3)
        for axis in range(3):
            sums[:, axis] = np.bincount(
                edges.of_halfedge, self._triangle_normals[owners, axis], minlength=len(edges.ends)
            )
        # Edge index of each triangle side. A triangle with a repeated vertex has no normal and is left out.
        self._side_edges = np.zeros((len(mesh.triangles), 3), np.int64)
        self._side_edges[kept] = edges.of_halfedge.reshape(-1, 3)
        self._has_distinct_vertices = kept

    def compute_signs(self, points: Floats, nearest: ClosestPoints) -> Floats:
        """Return 1 for points (k, 3) in front of the surface, else -1."""
        return np.where(self.compute_heights(points, nearest) < 0, -1.0, 1.0)

    def compute_heights(self, points: Floats, nearest: ClosestPoints) -> Floats:
        """Compute heights (k,) of points above the pseudonormals at their nearest points.

        The heights are scaled by the length of the pseudonormal. Pseudonormals are not normalised: values of
        mesh parts that meet at a nearest point add up to the value of the whole surface.
        """
        outside = nearest.weights < _MIN_BARYCENTRIC_WEIGHT
        normals = self._triangle_normals[nearest.triangles].copy()
        one, two = outside.sum(axis=1) == 1, outside.sum(axis=1) >= 2
        # The side that starts at corner k is opposite to corner k + 2.
        side = (np.argmax(outside[one], axis=1) + 1) % 3
        on = nearest.triangles[one]
        normals[one] = self._edge_normals[self._side_edges[on, side]] * self._has_distinct_vertices[on, None]
        corner = np.argmax(nearest.weights[two], axis=1)
        normals[two] = self._vertex_normals[self._mesh.triangles[nearest.triangles[two], corner]]
        away = points - interpolate_values(self._mesh.vertices, self._mesh, nearest)
        return np.asarray(np.einsum("kx,kx->k", away, normals))


def build_pseudonormals(mesh: Mesh) -> Pseudonormals | None:
    """Build the pseudonormals of a consistently oriented mesh.

    Returns None if neighbouring triangles disagree in orientation, or an edge has more than two triangles.
    """
    edges = build_edges(mesh.triangles[~has_repeated_vertex(mesh.triangles)], len(mesh.vertices))
    has_sides = not is_inconsistent(edges).any() and not (edges.triangle_count > 2).any()
    return Pseudonormals(mesh, edges) if has_sides else None


def _sum_angle_weighted_normals(mesh: Mesh, normals: Floats) -> Floats:
    """Return the angle-weighted sum of triangle normals at each vertex, (n, 3)."""
    # One coordinate at a time: faster than rows of three.
    columns = np.array([[x.take(corner) for x in mesh.vertices.T] for corner in mesh.triangles.T])
    sums: NDArray[np.float64] = np.zeros((len(mesh.vertices), 3))
    for k in range(3):
        first, second = columns[(k + 1) % 3] - columns[k], columns[(k + 2) % 3] - columns[k]
        across = [first[i] * second[j] - first[j] * second[i] for i, j in ((1, 2), (2, 0), (0, 1))]
        angles = np.arctan2(np.sqrt(sum(x * x for x in across)), sum(first * second))
        for axis in range(3):
            weighted = angles * normals[:, axis]
            sums[:, axis] += np.bincount(mesh.triangles[:, k], weighted, minlength=len(sums))
    return sums
