"""Coloured and textured sheets and bodies for tests of file formats."""

from __future__ import annotations

import numpy as np
import trimesh

from scanloom import Image, Material, Mesh, Texture
from scanloom.stages.files.image_bytes import encode_image

UP = (0.0, -1.0, 0.0)


def sheet(side: int = 12) -> Mesh:
    """Make a bumpy coloured sheet at (1, 2, 3), with coordinates in single precision."""
    rng = np.random.default_rng(5)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side)))
    vertices = np.stack([x, y, 0.05 * rng.random(len(x))], axis=1) + np.array((1, 2, 3))
    at = np.arange(side * side).reshape(side, side)
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], axis=-1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    colors = rng.integers(0, 256, (len(vertices), 3)).astype(np.uint8)
    return Mesh(vertices.astype(np.float32).astype(np.float64), triangles, colors)


def textured_sheet(side: int = 12, kind: str = "png") -> Mesh:
    """Make a sheet of two materials that share one noise image of 64 × 48 pixels."""
    mesh = sheet(side)
    uvs = mesh.vertices[mesh.triangles][:, :, :2] - (1, 2)
    pixels = np.random.default_rng(3).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    image = Image(given=pixels)
    if kind != "png":
        image = Image(f"a.{kind}", encode_image(pixels, kind, 95))
    ids = (np.arange(len(uvs)) % 2).astype(np.int32)
    materials = (Material("one", image), Material("two", image, base_color=(0.5, 0.25, 1.0, 1.0)))
    return mesh.with_(colors=None, texture=Texture(uvs, ids, materials), up=UP)


def ball() -> Mesh:
    """Make a sphere of radius 5 cm at (1, 1, 1)."""
    made = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    return Mesh(np.array(made.vertices) + 1, np.array(made.faces, np.int32), up=UP)


def make_bumpy_body(seed: int = 1) -> Mesh:
    """Make a closed body without rotational or mirror symmetry."""
    made = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    rng = np.random.default_rng(seed)
    vertices = np.array(made.vertices)
    for centre in rng.normal(size=(12, 3)):
        centre = centre / np.linalg.norm(centre)
        vertices *= 1 + 0.2 * rng.random() * np.exp(-8 * (1 - made.vertices @ centre))[:, None]
    return Mesh(vertices * (1, 0.8, 0.6), np.array(made.faces, np.int32))
