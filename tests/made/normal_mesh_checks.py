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

# So that made meshes of some thousand triangles are remeshed in no time.
SMALL_PARAMETERS = {"levels": 2, "base_triangles": 120}
# As exact as 32-bit floats, where a test asks whether something is on the surface.
EXACT_PARAMETERS = {**SMALL_PARAMETERS, "tolerance": 5e-8}


@cache
def remesh_cached(make: Callable[[], Mesh], scheme: str = "linear") -> tuple[Mesh, NormalMesh]:
    """Return a made mesh and what remesh makes of it: several tests look at the same one."""
    mesh = make()
    return mesh, remesh(mesh, scheme=scheme, **EXACT_PARAMETERS)


def compute_diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def compute_normals(mesh: Mesh) -> NDArray[np.float64]:
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    doubled = np.cross(b - a, c - a)
    return doubled / np.linalg.norm(doubled, axis=1, keepdims=True)


def assert_valid_normal_mesh(found: NormalMesh, mesh: Mesh, within: float = 1e-6) -> None:
    """At every level vertices are on the surface, no triangle is flipped or flat, the topology stays."""
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
    """Each vertex of a level is on the triangle it is said to be on.

    In double precision: of needles, single precision does not know where they are.
    """
    # trimesh takes products of lengths below 1e-8 for nothing.
    scale = 1e6 / compute_diagonal(mesh)
    corners, points = scale * mesh.vertices[mesh.triangles[triangles]], scale * level.vertices
    closest = trimesh.triangles.closest_point(corners, points)
    assert np.linalg.norm(closest - points, axis=1).max() <= 1
