"""Bilateral normal filtering with fixed constants, the floor for surface refinement.

Normals of triangles that share a vertex are averaged with weights for area, distance and angle. Vertices then
move until the triangles fit the filtered normals. The filter knows neither sensor nor photos.

References
----------
Zheng, Fu, Au and Tai, "Bilateral normal filtering for mesh denoising", 2011; Sun, Rosin, Martin and Langbein,
"Fast and effective feature-preserving mesh denoising", 2007 (vertex update).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

_ITERATIONS = 12
_ANGLE_DEG = 18.0  # standard deviation of the angle between normals that are averaged


def filter_mesh(mesh: Mesh, *, iterations: int = _ITERATIONS, angle_deg: float = _ANGLE_DEG) -> Mesh:
    """Smooth a mesh by bilateral normal filtering and vertex updates.

    Parameters
    ----------
    iterations : of the filter and of the vertex update.
    angle_deg : angle between normals at which the weight falls to 61 %.
    """
    normals = _filter_normals(mesh, iterations, 2 * np.sin(np.radians(angle_deg) / 2))
    return mesh.with_(vertices=_fit_vertices(mesh, normals, iterations), normals=None)


def _filter_normals(mesh: Mesh, iterations: int, chord: float) -> Floats:
    corners = mesh.vertices[mesh.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(areas, 1e-30)[:, None]
    first, second = _find_neighbours(mesh)
    centers = corners.mean(axis=1)
    distances = np.linalg.norm(centers[first] - centers[second], axis=1)
    weights = areas[second] * np.exp(-(distances**2) / (2 * distances.mean() ** 2))
    for _ in range(iterations):
        differences = ((normals[first] - normals[second]) ** 2).sum(axis=1)
        shares = weights * np.exp(-differences / (2 * chord**2))
        sums = [np.bincount(first, shares * normals[second, axis], len(areas)) for axis in range(3)]
        total = np.stack(sums, axis=1) + areas[:, None] * normals
        normals = total / np.maximum(np.linalg.norm(total, axis=1), 1e-30)[:, None]
    return normals


def _find_neighbours(mesh: Mesh) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Find pairs of triangles that share a vertex, both directions."""
    import scipy.sparse

    count = len(mesh.triangles)
    rows = np.repeat(np.arange(count), 3)
    incidence = scipy.sparse.csr_matrix(
        (np.ones(3 * count, np.int8), (rows, mesh.triangles.ravel())), (count, len(mesh.vertices))
    )
    pairs = (incidence @ incidence.T).tocoo()
    apart = pairs.row != pairs.col
    return pairs.row[apart], pairs.col[apart]


def _fit_vertices(mesh: Mesh, normals: Floats, iterations: int) -> Floats:
    vertices, count = mesh.vertices, len(mesh.vertices)
    valence = np.maximum(np.bincount(mesh.triangles.ravel(), minlength=count), 1)
    for _ in range(iterations):
        centers = vertices[mesh.triangles].mean(axis=1)
        steps = np.zeros_like(vertices)
        for corner in mesh.triangles.T:
            heights = ((centers - vertices[corner]) * normals).sum(axis=1)
            for axis in range(3):
                steps[:, axis] += np.bincount(corner, heights * normals[:, axis], count)
        vertices = vertices + steps / valence[:, None]
    return vertices
