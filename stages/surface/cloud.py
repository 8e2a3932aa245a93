"""Clouds of points: meshes without triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

# Points that tell how a cloud lies around one of them.
_NEIGHBOURS = 30


def is_cloud(mesh: Mesh) -> bool:
    """Return whether there are points and no triangles."""
    return len(mesh.triangles) == 0 and len(mesh.vertices) > 0


def some_of(cloud: Mesh, most: int) -> Mesh:
    """Return a cloud of at most so many of its points, the same ones every time, with normals.

    Where it has none they are found in the points around each, and look either way.
    """
    rows = np.arange(len(cloud.vertices))
    if len(rows) > most:
        rows = np.sort(np.random.default_rng(0).choice(len(rows), most, replace=False))
    points = cloud.vertices[rows]
    return cloud.with_(
        vertices=points,
        colors=None if cloud.colors is None else cloud.colors[rows],
        normals=_normals_of(points, cloud.vertices) if cloud.normals is None else cloud.normals[rows],
    )


def _normals_of(points: Floats, cloud: Floats) -> Floats:
    """Return along which direction (k, 3) of length 1 the cloud is thinnest around points (k, 3) of it."""
    from scipy.spatial import cKDTree

    _, near = cKDTree(cloud, balanced_tree=False).query(points, min(_NEIGHBOURS, len(cloud)), workers=-1)
    around = cloud[near] - points[:, None]
    around -= around.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("kni,knj->kij", around, around))[1][:, :, 0])
