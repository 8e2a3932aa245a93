"""Tangential umbrella Laplacian, which evens out triangles without shrinking the surface."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.edges import build_edges
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.vertex_normals import compute_vertex_normals


def relax_tangentially(mesh: Mesh, steps: int = 1) -> Mesh:
    """Move interior vertices towards the mean of their neighbours, within the tangent plane.

    Li, Li, Xu and Li, "Normal mesh generation based on Laplacian operator" (2002), equations (2) to (4): with
    the neighbours v_j of a vertex v and its unit normal n, each step adds T(v) = l(v) - (l(v) . n) n, where
    l(v) is the mean of v_j - v. All vertices move at once. Boundary vertices stay. The paper does not say how
    normals are estimated; here they are area-weighted.

    Parameters
    ----------
    mesh : triangles, metres. Attributes of vertices stay with their vertices.
    steps : number of steps, at least 0.

    Returns
    -------
    Mesh
        The same triangles and attributes, with moved vertices. Normals are dropped.
    """
    count = len(mesh.vertices)
    edges = build_edges(mesh.triangles, count)
    ends = edges.ends[edges.ends[:, 0] != edges.ends[:, 1]]
    degree = np.bincount(ends.reshape(-1), minlength=count)
    moves = degree > 0
    moves[edges.ends[edges.triangle_count == 1]] = False
    start, end = np.concatenate([ends, ends[:, ::-1]]).T
    for _ in range(steps):
        points = mesh.vertices
        sums = np.stack([np.bincount(start, column[end], count) for column in points.T], axis=1)
        laplacian = sums[moves] / degree[moves, None] - points[moves]
        normals = compute_vertex_normals(mesh)[moves]
        along = np.einsum("ij,ij->i", laplacian, normals)
        moved = points.copy()
        moved[moves] += laplacian - along[:, None] * normals
        mesh = mesh.with_(vertices=moved, normals=None, corner_normals=None)
    return mesh
