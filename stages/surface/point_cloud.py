"""Point clouds, represented as meshes without triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

# Nearest neighbours per point for normal estimation.
_NEIGHBOUR_COUNT = 30


def is_cloud(mesh: Mesh) -> bool:
    """Return True if the mesh has points but no triangles."""
    return len(mesh.triangles) == 0 and len(mesh.vertices) > 0


def subsample_cloud(cloud: Mesh, max_points: int) -> Mesh:
    """Subsample a cloud to at most `max_points` points, reproducibly, and add normals.

    Missing normals are estimated from the neighbours of each point in the full cloud. Their sign is
    arbitrary.
    """
    rows = np.arange(len(cloud.vertices))
    if len(rows) > max_points:
        rows = np.sort(np.random.default_rng(0).choice(len(rows), max_points, replace=False))
    points = cloud.vertices[rows]
    return cloud.with_(
        vertices=points,
        colors=None if cloud.colors is None else cloud.colors[rows],
        normals=_estimate_normals(points, cloud.vertices) if cloud.normals is None else cloud.normals[rows],
    )


def _estimate_normals(points: Floats, cloud: Floats) -> Floats:
    """Estimate unit normals (k, 3) by PCA of neighbouring points.

    The neighbours are searched in the full cloud. The sign of a normal is arbitrary.
    """
    from scipy.spatial import cKDTree

    _, near = cKDTree(cloud, balanced_tree=False).query(points, min(_NEIGHBOUR_COUNT, len(cloud)), workers=-1)
    around = cloud[near] - points[:, None]
    around -= around.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("kni,knj->kij", around, around))[1][:, :, 0])
