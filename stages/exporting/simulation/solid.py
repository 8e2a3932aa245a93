"""Geometry of a mesh as a solid, if it encloses one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanloom.stages.surface.equal_positions import find_equal_positions
from scanloom.stages.surface.hole_filling import fill_holes
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import compute_areas, has_repeated_vertex, topology
from scanloom.stages.surface.tracked_mesh import TrackedMesh

# Area of the caps, relative to the surface. A larger opening is no hole of an object: closing a room scan
# would fill the room.
_MAX_CAP_RATIO = 0.25


@dataclass(frozen=True, eq=False)
class SolidGeometry:
    """Welded geometry of a mesh.

    Attributes
    ----------
    surface : mesh without colours, texture and duplicate vertices, closed by caps if `is_solid`.
    is_solid : the surface is closed, consistently oriented, and encloses a positive volume.
    cap_ratio : area of the caps that close holes, relative to the area of the surface.
    """

    surface: Mesh
    is_solid: bool
    cap_ratio: float


def build_solid(mesh: Mesh) -> SolidGeometry:
    """Weld the vertices of a mesh and close its holes if that makes it a solid."""
    sets, first = find_equal_positions(mesh.vertices)
    triangles = sets[mesh.triangles].astype(np.int32)
    welded = Mesh(mesh.vertices[first], triangles[~has_repeated_vertex(triangles)], up=mesh.up)
    areas = compute_areas(welded.vertices, welded.triangles)
    if _is_closed(welded):
        return SolidGeometry(welded, compute_volume(welded) > 0, 0.0)
    filled = fill_holes(TrackedMesh.start(welded))[0].mesh
    caps = compute_areas(filled.vertices, filled.triangles[len(welded.triangles) :])
    ratio = float(caps.sum() / areas.sum()) if areas.sum() > 0 else np.inf
    if ratio <= _MAX_CAP_RATIO and _is_closed(filled) and compute_volume(filled) > 0:
        return SolidGeometry(filled, True, ratio)
    return SolidGeometry(welded, False, 0.0)


def compute_volume(mesh: Mesh) -> float:
    """Compute the volume that a closed mesh encloses; negative if it is inside out."""
    origin = mesh.vertices.mean(axis=0)
    a, b, c = (mesh.vertices - origin)[mesh.triangles].transpose(1, 0, 2)
    return float(np.einsum("nx,nx->", a, np.cross(b, c)) / 6)


def _is_closed(mesh: Mesh) -> bool:
    found = topology(mesh)
    return found.is_closed and found.is_oriented
