"""Coloured meshes of several topologies, and a check that topology is unchanged.

trimesh is imported inside functions, because its import takes half a second and many test processes only need
a sheet.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology


def sheet(n: int = 40, noise: float = 0.001, height: float = 0.1) -> Mesh:
    """Make a hilly unit square of 2 n² triangles.

    Red and green increase along x and y; blue has stripes.
    """
    y, x = np.mgrid[0 : n + 1, 0 : n + 1] / n
    z = height * np.sin(7 * x) * np.cos(5 * y) + np.random.default_rng(0).normal(0, noise, x.shape)
    vertices = np.stack([x, y, z], -1).reshape(-1, 3)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    b, c, d = a + 1, a + n + 2, a + n + 1
    triangles = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    colors = np.stack([255 * x, 255 * y, 90 * ((x * 4).astype(int) % 2)], -1).reshape(-1, 3)
    return Mesh(vertices, triangles.astype(np.int32), colors=np.rint(colors).astype(np.uint8))


def color_trimesh(made: Any) -> Mesh:
    vertices = np.array(made.vertices)
    colors = np.clip(128 + 90 * np.sin(5 * vertices), 0, 255).astype(np.uint8)
    return Mesh(vertices, np.array(made.faces, np.int32), colors=colors)


def ball() -> Mesh:
    import trimesh

    return color_trimesh(trimesh.creation.icosphere(subdivisions=4))


def ring() -> Mesh:
    import trimesh

    return color_trimesh(trimesh.creation.torus(1.0, 0.4, major_sections=64, minor_sections=32))


def make_holed_sheet() -> Mesh:
    mesh = sheet()
    square = np.floor(mesh.vertices[mesh.triangles].mean(axis=1)[:, :2] * 40)
    holes = [np.abs(square - center).max(axis=1) < 5 for center in ((12, 12), (28, 25))]
    return Mesh(mesh.vertices, mesh.triangles[~(holes[0] | holes[1])], colors=mesh.colors)


MESHES = {"sheet": sheet, "ball": ball, "ring": ring, "holed": make_holed_sheet}


def assert_same_topology(now: Mesh, before: Mesh) -> None:
    was, is_now = topology(before), topology(now)
    assert is_now.is_manifold
    assert is_now.is_oriented
    for name in ("euler", "boundary_loops", "components", "duplicate"):
        assert getattr(is_now, name) == getattr(was, name), name
    assert is_now.unreferenced == 0


def make_square(depth: float = 0.0, turned: bool = False) -> Mesh:
    """Make two triangles over the unit square that face up, or down if `turned`."""
    vertices = np.array([[0, 0, depth], [1, 0, depth], [1, 1, depth], [0, 1, depth]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(vertices, triangles[:, ::-1] if turned else triangles)


def join_meshes(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    triangles = [mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    colors = [mesh.colors for mesh in meshes]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(triangles).astype(np.int32),
        None if colors[0] is None else np.concatenate(colors),
    )


def sample_inside(mesh: Mesh, count: int = 5000, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample random points in triangles: triangle, weights, position."""
    rng = np.random.default_rng(seed)
    triangles = rng.choice(len(mesh.triangles), count)
    weights = rng.dirichlet((1, 1, 1), count)
    return triangles, weights, np.einsum("kc,kcx->kx", weights, mesh.vertices[mesh.triangles[triangles]])
