"""How far the first level of a hierarchy goes, where nobody says."""

from __future__ import annotations

import numpy as np

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
    normal, mean, valence = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for i in range(3):
        np.add.at(normal, triangles[:, i], normals)
        np.add.at(mean, triangles[:, i], corners[:, (i + 1) % 3] + corners[:, (i + 2) % 3])
        np.add.at(valence, triangles[:, i], 2.0)
    length = np.linalg.norm(normal, axis=1)
    told = (length > 0) & (valence > 0)
    offset = mesh.vertices[told] - mean[told] / valence[told, None]
    height = np.abs(np.einsum("ij,ij->i", offset, normal[told])) / length[told]
    found = _PER_HEIGHT * float(np.median(height)) if told.any() else 0.0
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    return max(found, _LEAST_PER_DIAGONAL * diagonal, float(np.finfo(np.float64).tiny))
