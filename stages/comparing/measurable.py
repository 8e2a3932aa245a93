"""Meshes and clouds that can be measured, of whatever is given. A cloud is a mesh without triangles."""

from __future__ import annotations

import numpy as np

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.cloud import is_cloud
from scanloom.stages.surface.codes import MESH_NO_SURFACE
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, bounding_box
from scanloom.stages.surface.topology import require_area, require_measurable


def measurable(given: MeshLike, called: str) -> Mesh:
    """Return a mesh that has an area.

    Raises
    ------
    MeshError
        If it has none, or is no mesh; `called` names it there.
    """
    mesh = as_mesh(given, called)
    require_area(mesh, called)
    return mesh


def comparable(given: MeshLike, called: str) -> Mesh:
    """Return a mesh that has an area, or a cloud of points that are not all in one place.

    Raises
    ------
    MeshError
        If it is neither; `called` names it there.
    """
    mesh = as_mesh(given, called)
    if not is_cloud(mesh):
        require_area(mesh, called)
        return mesh
    require_measurable(mesh, called)
    if not np.ptp(mesh.vertices, axis=0).any():
        raise MeshError(MESH_NO_SURFACE, "it has no triangles, and its points are all in one place.", called)
    return mesh


def box_of(*meshes: Mesh) -> Floats:
    """Return the lowest and the highest corner, (2, 3), around all that counts of meshes and clouds."""
    boxes = [_box_of_points(mesh.vertices) if is_cloud(mesh) else bounding_box(mesh) for mesh in meshes]
    lows, highs = np.array(boxes).swapaxes(0, 1)
    return np.array([lows.min(axis=0), highs.max(axis=0)])


def gap_of_unrelated(a: Mesh, b: Mesh) -> float | None:
    """Return the gap between two meshes or clouds in metres if it exceeds the size of the smaller one.

    Returns None otherwise: scans of one object need not touch, as two sides of a wall, but they are close
    compared to their size. Both must have points.
    """
    (low_a, high_a), (low_b, high_b) = box_of(a), box_of(b)
    between = np.maximum(np.maximum(low_a - high_b, low_b - high_a), 0)
    gap = float(np.linalg.norm(between))
    sizes = (float(np.linalg.norm(high - low)) for low, high in ((low_a, high_a), (low_b, high_b)))
    return gap if gap > min(sizes) else None


def _box_of_points(points: Floats) -> Floats:
    return np.array([points.min(axis=0), points.max(axis=0)])
