"""Area-weighted vertex normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh


def compute_vertex_normals(mesh: Mesh) -> NDArray[np.float64]:
    """Compute area-weighted unit vertex normals (n, 3); 0 for unused vertices."""
    return normalize_vectors(sum_normals(mesh))


def sum_normals(mesh: Mesh) -> NDArray[np.float64]:
    """Sum the triangle normals around each vertex (n, 3).

    A triangle normal is twice the triangle's area long (m²).
    """
    # One coordinate at a time is three times faster than rows of three, and this runs over all triangles.
    a, b, c = mesh.triangles.T
    ab, ac = ([x[end] - x[a] for x in mesh.vertices.T] for end in (b, c))
    normals = np.zeros((len(mesh.vertices), 3))
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        weighted = ab[i] * ac[j] - ab[j] * ac[i]
        for corner in (a, b, c):  # bincount is an order of magnitude faster than np.add.at
            normals[:, axis] += np.bincount(corner, weighted, minlength=len(normals))
    return normals


def normalize_vectors(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalize vectors (n, 3) to unit length; zero vectors stay zero."""
    lengths = np.sqrt(np.einsum("kx,kx->k", normals, normals))
    return np.asarray(normals / np.maximum(lengths, np.finfo(np.float64).tiny)[:, None])
