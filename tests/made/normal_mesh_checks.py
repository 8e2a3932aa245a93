"""Checks that hold for every normal mesh."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import trimesh
from coloured_meshes import assert_same_topology
from numpy.typing import NDArray

from scanloom.stages.normal_meshes.normal_mesh import NormalMesh
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.topology import topology

# Meshes of a few thousand triangles are remeshed in milliseconds.
SMALL_PARAMETERS = {"levels": 2, "base_triangles": 120}
# Precision of 32-bit floats, for tests that check if a point is on the surface.
EXACT_PARAMETERS = {**SMALL_PARAMETERS, "tolerance": 5e-8}


@cache
def remesh_cached(make: Callable[[], Mesh], scheme: str = "linear") -> tuple[Mesh, NormalMesh]:
    """Remesh a made mesh; the result is cached, because several tests check the same one."""
    mesh = make()
    return mesh, remesh(mesh, scheme=scheme, **EXACT_PARAMETERS)


def compute_diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def compute_normals(mesh: Mesh) -> NDArray[np.float64]:
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    doubled = np.cross(b - a, c - a)
    return doubled / np.linalg.norm(doubled, axis=1, keepdims=True)


def assert_valid_normal_mesh(found: NormalMesh, mesh: Mesh, within: float = 1e-6) -> None:
    """Check each level.

    Vertices are on the surface, no triangle is flipped or flat, topology is unchanged.
    """
    surface = RaycastingSurface(mesh)
    facing = compute_normals(mesh)
    for level in found.levels:
        assert surface.find_closest_points(level.vertices).distances.max() <= within * compute_diagonal(mesh)
        assert topology(level).degenerate == 0
        assert_same_topology(level, mesh)
    assert found.folded_count == 0
    assert sum(found.folded_by_level) == 0
    finest = found.mesh
    middles = finest.vertices[finest.triangles].mean(axis=1)
    there = facing[surface.find_closest_points(middles).triangles]
    assert (np.einsum("ij,ij->i", compute_normals(finest), there) > 0).all()


def assert_on_triangles(level: Mesh, triangles: NDArray[np.int32], mesh: Mesh) -> None:
    """Check that each vertex of a level is on its recorded triangle.

    Computed in double precision, because single precision cannot locate points on needle triangles.
    """
    # trimesh treats products of lengths below 1e-8 as zero.
    scale = 1e6 / compute_diagonal(mesh)
    corners, points = scale * mesh.vertices[mesh.triangles[triangles]], scale * level.vertices
    closest = trimesh.triangles.closest_point(corners, points)
    assert np.linalg.norm(closest - points, axis=1).max() <= 1
