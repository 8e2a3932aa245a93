"""Textured models with known materials, and sample points on their surfaces."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from seamed_meshes import wrapped_ball

from scanloom.stages.surface.formats.gltf_materials import GltfMaterialSource
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture


def waves(width: int = 512, height: int = 256) -> NDArray[np.uint8]:
    """Make smooth colours that differ everywhere in the image and match at its left and right edge."""
    y, x = np.mgrid[0:height, 0:width]
    u, v = 2 * np.pi * x / width, np.pi * y / height
    channels = [np.sin(3 * u) * np.sin(v), np.cos(5 * u) * np.sin(v), np.sin(4 * v)]
    return np.rint(128 + 100 * np.stack(channels, axis=2)).astype(np.uint8)


def encode_jpeg(pixels: NDArray[np.uint8], quality: int = 80, subsampling: int = 2) -> Image:
    """Encode an image as a JPEG file."""
    file = io.BytesIO()
    PillowImage.fromarray(pixels).save(file, "JPEG", quality=quality, subsampling=subsampling)
    return Image("source.jpg", file.getvalue())


def encode_png(pixels: NDArray[np.uint8]) -> Image:
    """Encode an image as a PNG file."""
    file = io.BytesIO()
    PillowImage.fromarray(pixels).save(file, "PNG")
    return Image("source.png", file.getvalue())


def textured_ball(image: Image, rings: int = 32, sectors: int = 48, bumps: float = 0.0) -> Mesh:
    """Make a sphere with an image wrapped around it."""
    mesh = wrapped_ball(rings, sectors, bumps)
    assert mesh.texture is not None
    texture = Texture(mesh.texture.uvs, mesh.texture.material_ids, (Material("map", image),))
    return mesh.with_(texture=texture)


def replace_materials(mesh: Mesh, materials: tuple[Material, ...], ids: NDArray[np.int32]) -> Mesh:
    """Replace the materials of a mesh."""
    assert mesh.texture is not None
    return mesh.with_(texture=Texture(mesh.texture.uvs, ids, materials))


def gltf_material(name: str, image: Image, maps: dict[str, Image] | None = None, **tree: object) -> Material:
    """Make a glTF material with a base colour image and textures such as normalTexture."""
    textures = {0: (image, {})}
    described: dict[str, object] = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, **tree}
    for index, (key, one) in enumerate((maps or {}).items(), 1):
        textures[index] = (one, {})
        described[key] = {"index": index}
    return Material(name, image, kept=GltfMaterialSource(described, textures, None, image))


def bumpy_plane(cells: int = 24, pixels: int = 256) -> tuple[Mesh, object]:
    """Make a flat square whose normal map encodes hills, and a function of the true normals.

    The normal map is rotated by 0.5 radians in the image.
    """
    y, x = np.mgrid[0 : cells + 1, 0 : cells + 1] / cells
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    b, c, d = a + 1, a + cells + 2, a + cells + 1
    triangles = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3).astype(np.int32)
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    # Texture coordinates: the plane rotated and scaled into the image.
    places = 0.6 * (vertices[:, :2] - 0.5) @ turn.T + 0.5

    def normals(points: NDArray[np.float64]) -> NDArray[np.float64]:
        px, py = points[:, 0], points[:, 1]
        slopes = np.stack([0.6 * np.cos(9 * px) * np.cos(4 * py), 0.5 * np.sin(6 * py + px)], axis=1)
        found = np.column_stack([-slopes, np.ones(len(points))])
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    v, u = np.mgrid[0:pixels, 0:pixels]
    uv = np.stack([(u + 0.5) / pixels, 1 - (v + 0.5) / pixels], axis=-1).reshape(-1, 2)
    world = normals(((uv - 0.5) / 0.6) @ turn + 0.5)
    # Tangent frame: u runs along the first row of the rotation.
    local = np.column_stack([world[:, :2] @ turn.T, world[:, 2]])
    encoded = np.rint(127.5 * (local + 1)).astype(np.uint8).reshape(pixels, pixels, 3)
    image = encode_png(waves(pixels, pixels))
    material = gltf_material("hills", image, {"normalTexture": encode_png(encoded)})
    ids = np.zeros(len(triangles), np.int32)
    up = np.broadcast_to([0.0, 0.0, 1.0], vertices.shape).copy()
    return Mesh(
        vertices, triangles, normals=up, texture=Texture(places[triangles], ids, (material,))
    ), normals


def sample_points(
    mesh: Mesh, count: int = 4000
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Sample points on a mesh uniformly by area: triangles, barycentric weights, positions."""
    rng = np.random.default_rng(3)
    corners = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    triangles = rng.choice(len(area), count, p=area / area.sum())
    weights = rng.dirichlet((1, 1, 1), count)
    return triangles, weights, np.einsum("kc,kcx->kx", weights, corners[triangles])
