"""Random meshes: soups, height fields, closed and textured meshes, of any size and position."""

from __future__ import annotations

import random

import numpy as np
from coloured_meshes import color_trimesh, sheet
from numpy.typing import NDArray
from seamed_meshes import folded_strips, two_cubes, wrapped_ball

from scanloom.stages.surface.mesh import Mesh

# Closed and manifold after welding, so results must not have a boundary.
CLOSED = ("ball", "ring", "wrapped ball", "cubes")


def make_random_mesh(draw: random.Random) -> tuple[str, Mesh]:
    """Make a random mesh; return its kind and the mesh."""
    kind = draw.choice(("soup", "sheet", "sheet", "holed", "strips", "torn", *CLOSED, *CLOSED))
    mesh = _make_mesh(kind, draw)
    if draw.random() < 0.3 and mesh.texture is None:
        mesh = mesh.with_(colors=None)
    if draw.random() < 0.2:
        rng = np.random.default_rng(draw.randrange(2**32))
        mesh = mesh.with_(normals=_normalize(rng.normal(size=mesh.vertices.shape)))
    # Powers of two change only the size; far from the origin, coordinates are coarser.
    size = draw.choice((1.0, 1.0, 1.0, 2.0**-10, 2.0**12))
    place = draw.choice((0.0, 0.0, 1.0, 64.0, 4096.0)) * size
    return kind, mesh.with_(vertices=mesh.vertices * size + place)


def _make_mesh(kind: str, draw: random.Random) -> Mesh:
    import trimesh

    rng = np.random.default_rng(draw.randrange(2**32))
    match kind:
        case "soup":
            return _make_soup(rng, draw)
        case "ball":
            mesh = color_trimesh(trimesh.creation.icosphere(subdivisions=draw.choice((1, 2, 3))))
        case "ring":
            mesh = color_trimesh(trimesh.creation.torus(1.0, draw.uniform(0.05, 0.9), 24, 12))
        case "wrapped ball":
            return wrapped_ball(draw.randrange(3, 16), draw.randrange(3, 20), draw.uniform(0, 0.3))
        case "cubes":
            return two_cubes(draw.choice((1e-9, 0.01, 1.0)))
        case "strips":
            return folded_strips(draw.randrange(3, 14), 2 * draw.randrange(1, 5) + 1, draw.uniform(0, 0.3))
        case _:
            mesh = sheet(draw.randrange(1, 28), draw.choice((0.0, 0.001, 0.02)), draw.uniform(0, 0.5))
    if kind == "holed":
        stays = rng.random(len(mesh.triangles)) > 0.03
        mesh = mesh.with_triangles(mesh.triangles[stays], stays)
    if kind == "torn":
        return _tear(mesh, rng)
    if draw.random() < 0.5:
        near = 0.02 / np.sqrt(len(mesh.triangles))
        mesh = mesh.with_(vertices=mesh.vertices + rng.normal(0, near, mesh.vertices.shape))
    return mesh


def _make_soup(rng: np.random.Generator, draw: random.Random) -> Mesh:
    """Make triangles between random vertices, some of them repeated, coincident or collinear."""
    count = draw.randrange(3, 80)
    vertices = rng.normal(size=(count, 3))
    if draw.random() < 0.5:
        vertices = np.round(vertices)
    if draw.random() < 0.2:
        vertices[:, 2] = 0
    triangles = rng.integers(0, count, (draw.randrange(1, 300), 3)).astype(np.int32)
    return Mesh(vertices, triangles, rng.integers(0, 256, (count, 3)).astype(np.uint8))


def _tear(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """Move some corners to other vertices, and repeat or flip some triangles."""
    triangles = mesh.triangles.copy()
    hit = rng.random(triangles.shape) < 0.01
    triangles[hit] = rng.integers(0, len(mesh.vertices), int(hit.sum()))
    turned = rng.random(len(triangles)) < 0.02
    triangles[turned] = triangles[turned][:, ::-1]
    return mesh.with_(triangles=np.vstack([triangles, triangles[rng.random(len(triangles)) < 0.02]]))


def _normalize(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
