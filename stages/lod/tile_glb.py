"""The GLB file of one tile.

Khronos Group, "glTF 2.0 specification", 2021, section 4.4 (the container); KHR_mesh_quantization;
KHR_materials_unlit; EXT_texture_webp; EXT_meshopt_compression. glTF is y-up, and viewers of 3D Tiles turn
it to z-up: what is (x, y, z) in a tileset is (x, z, -y) here.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.lod.grid import Grid
from scanloom.stages.surface.formats.colors import linear_from_srgb
from scanloom.stages.surface.formats.gltf_container import Tree
from scanloom.stages.surface.formats.gltf_materials import UNLIT
from scanloom.stages.surface.formats.gltf_packing import INDICES, PACKED, QUANTIZED, VERTICES, packed, strips
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image

_FLOAT, _SHORT, _INT = 5126, 5123, 5125
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_NONE = np.iinfo(np.uint16).max  # stands for no vertex in some programs
# The amount of light of each displayed value.
_LIGHT = np.rint(linear_from_srgb(np.arange(256) / 255) * 65535).astype(np.uint16)
_FULL = 0xFFFF  # the far end of an image in texture coordinates of 16 bits
_LINEAR, _MIPMAPS, _CLAMP = 9729, 9987, 33071
_WEBP, _WEBP_TYPE = "EXT_texture_webp", "image/webp"


def tile_glb(mesh: Mesh, grid: Grid, *, pack: bool = False) -> bytes:
    """Return a tile as the bytes of a GLB file.

    Positions are steps from the tile's own place on the grid, in 16 bits, which its node moves and scales
    back without loss; or places on the grid in single precision. Colours are amounts of light in 16 bits,
    from which the 8 bits that are displayed come back exactly. They are shown without further light: a scan
    has its own.

    Parameters
    ----------
    mesh : with at least one triangle, its positions on the grid, told from the grid's origin. If it has a
        texture, that is of one image, whose bytes are kept as they are; coordinates, in 16 bits, are within
        1/131070 of the image's side. Vertices are then there once for each place in the image: their
        positions stay what they are.
    grid : of all tiles.
    pack : the buffers, by EXT_meshopt_compression. The same triangles, vertices and values come out of them,
        in another order; the image is kept as it is.
    """
    image = None if mesh.texture is None else mesh.texture.images[0]
    mesh, uvs = _split_along_seams(mesh)
    if pack:
        mesh, uvs = _in_strips(mesh, uvs)
    views: list[tuple[NDArray[Any], int]] = []
    accessors: list[Tree] = []

    def accessor(values: NDArray[Any], kind: str, code: int, target: int, **details: Any) -> int:
        views.append((values, target))
        accessors.append({
            "bufferView": len(views) - 1,
            "componentType": code,
            "count": len(values),
            "type": kind,
            **details,
        })  # fmt: skip
        return len(accessors) - 1

    node: Tree = {"mesh": 0}
    steps = np.rint(mesh.vertices[:, [0, 2, 1]] / grid.step).astype(np.int64) * (1, 1, -1)
    if grid.in_16_bits:
        low = steps.min(axis=0)
        node |= {"translation": (low * grid.step).tolist(), "scale": [grid.step] * 3}
        # A row has to begin at a multiple of four bytes.
        positions = np.pad((steps - low).astype(np.uint16), ((0, 0), (0, 1)))
        code = _SHORT
    else:
        positions = (steps * grid.step).astype(np.float32)
        code = _FLOAT
    bounds = {"min": positions[:, :3].min(axis=0).tolist(), "max": positions[:, :3].max(axis=0).tolist()}
    attributes = {"POSITION": accessor(positions, "VEC3", code, VERTICES, **bounds)}
    if mesh.colors is not None:
        light = np.pad(_LIGHT[mesh.colors], ((0, 0), (0, 1)), constant_values=_LIGHT[-1])
        attributes["COLOR_0"] = accessor(light, "VEC4", _SHORT, VERTICES, normalized=True)
    if uvs is not None:
        attributes["TEXCOORD_0"] = accessor(uvs, "VEC2", _SHORT, VERTICES, normalized=True)
    narrow = len(mesh.vertices) < _NONE
    indices = mesh.triangles.reshape(-1).astype(np.uint16 if narrow else np.uint32)
    index = accessor(indices, "SCALAR", _SHORT if narrow else _INT, INDICES)
    material: Tree = {
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
        "doubleSided": True,
    }
    used = [QUANTIZED] if grid.in_16_bits else []
    tree: Tree = {
        "asset": {"version": "2.0", "generator": "scanloom"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": index, "material": 0}]}],
        "materials": [material],
        "accessors": accessors,
    }
    if image is not None:
        used += _add_image(tree, image, len(views))
        views.append((np.frombuffer(image.file_bytes, np.uint8), 0))
    if pack:
        used.append(PACKED)
    if used:
        tree["extensionsRequired"] = list(used)
    if mesh.colors is not None or image is not None:
        material["extensions"] = {UNLIT: {}}
        used.append(UNLIT)
    if used:
        tree["extensionsUsed"] = used
    return _container(tree, views, pack)


def _split_along_seams(mesh: Mesh) -> tuple[Mesh, NDArray[np.uint16] | None]:
    """Return a mesh with a vertex for each place in the image, and these, from its upper left corner."""
    if mesh.texture is None:
        return mesh, None
    places = np.rint((mesh.texture.uvs.reshape(-1, 2) * (1, -1) + (0, 1)) * _FULL)
    u, v = places.clip(0, _FULL).astype(np.int64).T
    wedges, index = np.unique(
        (mesh.triangles.reshape(-1).astype(np.int64) << 32) | (u << 16) | v, return_inverse=True
    )
    split = Mesh(mesh.vertices[wedges >> 32], index.reshape(-1, 3).astype(np.int32))
    return split, np.stack([wedges >> 16 & _FULL, wedges & _FULL], axis=1).astype(np.uint16)


def _in_strips(mesh: Mesh, uvs: NDArray[np.uint16] | None) -> tuple[Mesh, NDArray[np.uint16] | None]:
    """Return a mesh with triangles, and vertices as these name them first, in an order that packs well."""
    triangles, order = strips(mesh.triangles, len(mesh.vertices))
    colors = None if mesh.colors is None else mesh.colors[order]
    return Mesh(mesh.vertices[order], triangles, colors), None if uvs is None else uvs[order]


def _add_image(tree: Tree, image: Image, view: int) -> list[str]:
    """Describe the image of the only material, in a view of the buffer; return what a reader has to know."""
    texture: Tree = {"source": 0}
    is_webp = image.mime == _WEBP_TYPE
    tree["images"] = [{"bufferView": view, "mimeType": image.mime}]
    tree["samplers"] = [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}]
    tree["textures"] = [{"sampler": 0, **({"extensions": {_WEBP: texture}} if is_webp else texture)}]
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    return [_WEBP] if is_webp else []


def _container(tree: Tree, views: list[tuple[NDArray[Any], int]], pack: bool) -> bytes:
    """Return a description and its buffer as one file.

    What is packed says of itself where it would be in a second buffer, which is not there.
    """
    tree["bufferViews"], pieces, size, plain_size = [], [], 0, 0
    for values, target in views:
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        data = values.tobytes()
        stride = values.shape[1] * values.itemsize if target == VERTICES else values.itemsize
        view: Tree = {"buffer": 0, "byteOffset": size, "byteLength": len(data)}
        if target:
            view["target"] = target
        if target == VERTICES:
            view["byteStride"] = stride
        if pack and target:
            view |= {"buffer": 1, "byteOffset": plain_size}
            plain_size += len(data) + -len(data) % 4
            data, mode = packed(values, target)
            view["extensions"] = {
                PACKED: {
                    "buffer": 0,
                    "byteOffset": size,
                    "byteLength": len(data),
                    "byteStride": stride,
                    "count": len(values),
                    "mode": mode,
                }
            }
        tree["bufferViews"].append(view)
        pieces += [data, bytes(-len(data) % 4)]
        size += len(data) + -len(data) % 4
    tree["buffers"] = [{"byteLength": size}]
    if pack:
        tree["buffers"].append({"byteLength": plain_size, "extensions": {PACKED: {"fallback": True}}})
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = b"glTF" + np.array([2, 12 + 8 + len(text) + 8 + size, len(text), _JSON], "<u4").tobytes()
    return b"".join([head, text, np.array([size, _BIN], "<u4").tobytes(), *pieces])
