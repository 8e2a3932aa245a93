"""Input validation for comparisons; a mesh without triangles is a point cloud."""

from __future__ import annotations

import numpy as np

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.codes import MESH_NO_SURFACE
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.point_cloud import is_cloud
from scanloom.stages.surface.raycasting import Floats, compute_bounding_box
from scanloom.stages.surface.topology import require_area, require_measurable


def to_measurable_mesh(geometry: MeshLike, label: str) -> Mesh:
    """Convert the input to a mesh with a surface area.

    Raises
    ------
    MeshError
        If the input has no area or is not a mesh; the message names it `label`.
    """
    mesh = as_mesh(geometry, label)
    require_area(mesh, label)
    return mesh


def to_mesh_or_cloud(geometry: MeshLike, label: str) -> Mesh:
    """Convert the input to a mesh with area or a cloud with extent.

    Raises
    ------
    MeshError
        If the input is neither; the message names it `label`.
    """
    mesh = as_mesh(geometry, label)
    if not is_cloud(mesh):
        require_area(mesh, label)
        return mesh
    require_measurable(mesh, label)
    if not np.ptp(mesh.vertices, axis=0).any():
        raise MeshError(MESH_NO_SURFACE, "it has no triangles, and all its points coincide.", label)
    return mesh


def compute_joint_box(*meshes: Mesh) -> Floats:
    """Return the joint bounding box (2, 3) of meshes and clouds.

    Vertices that no triangle uses do not count.
    """
    boxes = [
        _compute_point_box(mesh.vertices) if is_cloud(mesh) else compute_bounding_box(mesh) for mesh in meshes
    ]
    lows, highs = np.array(boxes).swapaxes(0, 1)
    return np.array([lows.min(axis=0), highs.max(axis=0)])


def measure_unrelated_gap(a: Mesh, b: Mesh) -> float | None:
    """Measure the gap between two meshes or clouds that seem unrelated.

    Scans of one object need not touch (two sides of a wall), but their gap is small compared with their size.
    Both inputs must have points.

    Returns
    -------
    Distance between the bounding boxes in metres if it exceeds the smaller box diagonal, else None.
    """
    (low_a, high_a), (low_b, high_b) = compute_joint_box(a), compute_joint_box(b)
    between = np.maximum(np.maximum(low_a - high_b, low_b - high_a), 0)
    gap = float(np.linalg.norm(between))
    sizes = (float(np.linalg.norm(high - low)) for low, high in ((low_a, high_a), (low_b, high_b)))
    return gap if gap > min(sizes) else None


def _compute_point_box(points: Floats) -> Floats:
    return np.array([points.min(axis=0), points.max(axis=0)])
