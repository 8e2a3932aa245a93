"""How far the first level of a hierarchy goes, where nobody says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.surface.mesh import Mesh

# Share of the median height that the bound is.
_PER_HEIGHT = 1.4
# What is flat all over has levels too: the least bound, as a share of the diagonal.
_LEAST_PER_DIAGONAL = 1e-5


def first_error(mesh: Mesh) -> float:
    """Return a bound for the first level, in metres: how high vertices stand over their neighbours.

    Half of the vertices are no farther than this from the plane of the vertices around them, along their
    normal; about as many can go within it.
    """
    corners, triangles = mesh.vertices[mesh.triangles], mesh.triangles
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    count = len(mesh.vertices)
    corner = triangles.T.reshape(-1)
    others = [corners[:, (i + 1) % 3] + corners[:, (i + 2) % 3] for i in range(3)]
    normal = _sums(corner, np.tile(normals, (3, 1)), count)
    mean = _sums(corner, np.concatenate(others), count)
    valence = 2.0 * np.bincount(corner, minlength=count)
    length = np.linalg.norm(normal, axis=1)
    told = (length > 0) & (valence > 0)
    offset = mesh.vertices[told] - mean[told] / valence[told, None]
    height = np.abs(np.einsum("ij,ij->i", offset, normal[told])) / length[told]
    found = _PER_HEIGHT * float(np.median(height)) if told.any() else 0.0
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    return max(found, _LEAST_PER_DIAGONAL * diagonal, float(np.finfo(np.float64).tiny))


def _sums(at: NDArray[np.int32], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the sums (count, 3) of the rows (k, 3) that go to each place."""
    return np.stack([np.bincount(at, column, minlength=count) for column in values.T], axis=1)
