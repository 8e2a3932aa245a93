"""How thick the solid is that a surface encloses, by rays from each triangle inwards."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.surface.mesh import Mesh
from stages.surface.raycasting import Surface, bounding_box, chunks
from stages.surface.topology import is_degenerate

# Of the bounding box's diagonal: how far inside a ray begins. The ray caster tells no smaller lengths apart.
_START = 1e-6


def thickness(mesh: Mesh) -> NDArray[np.float64]:
    """Return the way (m,) from the middle of each triangle along its normal, inwards, out of the solid.

    Metres; NaN where it meets nothing, or another outside first, or the triangle has no area. It is exact to
    some 1e-6 of the bounding box's diagonal. A mesh without a closed piece has no inside, and no thickness.
    """
    found = np.full(len(mesh.triangles), np.nan)
    (proper,) = np.nonzero(~is_degenerate(mesh.vertices, mesh.triangles))
    if len(proper) == 0:
        return found
    surface = Surface(mesh)
    start = _START * float(np.linalg.norm(np.diff(bounding_box(mesh), axis=0)))
    for rows in chunks(len(proper)):
        triangles = proper[rows]
        corners = mesh.vertices[mesh.triangles[triangles]]
        inwards = np.cross(corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 0])
        inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
        hits = surface.cast(corners.mean(axis=1) + start * inwards, inwards)
        leaves = np.einsum("ij,ij->i", hits.normals, inwards[hits.rays]) > 0
        found[triangles[hits.rays[leaves]]] = hits.distances[leaves] + start
    return found
