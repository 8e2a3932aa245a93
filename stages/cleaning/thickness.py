"""Thickness of a solid: lengths of rays through it, along the inward normal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Vertices
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box, iterate_chunks
from scanloom.stages.surface.topology import is_degenerate

# Offset of thickness rays from the surface, as a ratio of the bounding box's diagonal. The ray caster cannot
# resolve shorter lengths.
_RAY_OFFSET_RATIO = 1e-6


def measure_thickness(mesh: Mesh, degenerate: Ids | None = None) -> NDArray[np.float64]:
    """Measure the thickness (m,) of the solid behind each triangle, in metres.

    A ray is cast from each triangle's centre along the inward normal. The result is NaN if the ray misses the
    surface or hits a front face first, and for degenerate triangles. The error is about 1e-6 of the bounding
    box's diagonal.

    Parameters
    ----------
    degenerate : triangles without area; None to find them.
    """
    if degenerate is None:
        (degenerate,) = np.nonzero(is_degenerate(mesh.vertices, mesh.triangles))
    thickness = np.full(len(mesh.triangles), np.nan)
    proper = np.delete(np.arange(len(mesh.triangles)), degenerate)
    if len(proper) == 0:
        return thickness
    surface = RaycastingSurface(mesh)
    for rows in iterate_chunks(len(proper)):
        corners = mesh.vertices[mesh.triangles[proper[rows]]]
        inwards = np.cross(corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 0])
        inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
        thickness[proper[rows]] = measure_thickness_at(surface, corners.mean(axis=1), inwards)
    return thickness


def measure_thickness_at(
    surface: RaycastingSurface, points: Vertices, inwards: Vertices
) -> NDArray[np.float64]:
    """Measure the thickness (k,) at points of the surface, along unit vectors into the solid."""
    thickness = np.full(len(points), np.nan)
    box = compute_bounding_box(surface.mesh)
    start = _RAY_OFFSET_RATIO * float(np.linalg.norm(box[1] - box[0]))
    hits = surface.cast_rays(points + start * inwards, inwards)
    leaves = np.einsum("ij,ij->i", hits.normals, inwards[hits.rays]) > 0
    thickness[hits.rays[leaves]] = hits.distances[leaves] + start
    return thickness
