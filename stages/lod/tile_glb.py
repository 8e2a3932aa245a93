"""GLB file of a single tile.

Sources: Khronos Group, "glTF 2.0 specification", 2021, section 4.4 (the container); KHR_mesh_quantization;
KHR_materials_unlit; EXT_texture_webp; EXT_meshopt_compression. glTF is y-up, and viewers of 3D Tiles rotate
it to z-up: (x, y, z) in the tileset is (x, z, -y) in the file.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.lod.position_grid import PositionGrid
from scanloom.stages.surface.formats.color_conversion import convert_srgb_to_linear
from scanloom.stages.surface.formats.gltf_container import JsonObject
from scanloom.stages.surface.formats.gltf_materials import UNLIT
from scanloom.stages.surface.formats.gltf_packing import (
    INDEX_TARGET,
    MESH_QUANTIZATION,
    MESHOPT_COMPRESSION,
    VERTEX_TARGET,
    compress_buffer,
    reorder_for_compression,
)
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image

_FLOAT, _SHORT, _INT = 5126, 5123, 5125
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_RESERVED_INDEX = np.iinfo(np.uint16).max  # reserved: marks a missing vertex in some programs
# Linear light of each sRGB level, 16 bits.
_LINEAR_LIGHT = np.rint(convert_srgb_to_linear(np.arange(256) / 255) * 65535).astype(np.uint16)
_MAX_UV = 0xFFFF  # 1.0 in 16-bit texture coordinates
_LINEAR, _MIPMAPS, _CLAMP = 9729, 9987, 33071
_WEBP, _WEBP_TYPE = "EXT_texture_webp", "image/webp"


def encode_tile_glb(mesh: Mesh, grid: PositionGrid, *, compress: bool = False) -> bytes:
    """Encode a tile as a GLB file.

    Positions are 16-bit steps from the tile's own offset on the grid, which the node's translation and scale
    restore without loss, or grid positions in single precision. Colours are linear light in 16 bits, from
    which the 8-bit sRGB levels are recovered exactly. The material is unlit, because a scan contains its own
    lighting.

    Parameters
    ----------
    mesh : at least one triangle, with positions on the grid, relative to its origin. A texture must have a
        single image, whose bytes are embedded unchanged. Texture coordinates are rounded to 16 bits, an error
        of at most 1/131070 of the side. Vertices are duplicated along texture seams.
    grid : common grid of all tiles.
    compress : compress the buffers with EXT_meshopt_compression. Triangles, vertices and values are kept in
        another order; the image is not compressed.
    """
    image = None if mesh.texture is None else mesh.texture.images[0]
    mesh, uvs = _split_along_seams(mesh)
    if compress:
        mesh, uvs = _reorder_in_strips(mesh, uvs)
    views: list[tuple[NDArray[Any], int]] = []
    accessors: list[JsonObject] = []

    def add_accessor(values: NDArray[Any], kind: str, code: int, target: int, **details: Any) -> int:
        views.append((values, target))
        accessors.append({
            "bufferView": len(views) - 1,
            "componentType": code,
            "count": len(values),
            "type": kind,
            **details,
        })  # fmt: skip
        return len(accessors) - 1

    node: JsonObject = {"mesh": 0}
    steps = np.rint(mesh.vertices[:, [0, 2, 1]] / grid.step).astype(np.int64) * (1, 1, -1)
    if grid.in_16_bits:
        low = steps.min(axis=0)
        node |= {"translation": (low * grid.step).tolist(), "scale": [grid.step] * 3}
        # Rows must be aligned to four bytes.
        positions = np.pad((steps - low).astype(np.uint16), ((0, 0), (0, 1)))
        code = _SHORT
    else:
        positions = (steps * grid.step).astype(np.float32)
        code = _FLOAT
    bounds = {"min": positions[:, :3].min(axis=0).tolist(), "max": positions[:, :3].max(axis=0).tolist()}
    attributes = {"POSITION": add_accessor(positions, "VEC3", code, VERTEX_TARGET, **bounds)}
    if mesh.colors is not None:
        light = np.pad(_LINEAR_LIGHT[mesh.colors], ((0, 0), (0, 1)), constant_values=_LINEAR_LIGHT[-1])
        attributes["COLOR_0"] = add_accessor(light, "VEC4", _SHORT, VERTEX_TARGET, normalized=True)
    if uvs is not None:
        attributes["TEXCOORD_0"] = add_accessor(uvs, "VEC2", _SHORT, VERTEX_TARGET, normalized=True)
    uses_16_bit_indices = len(mesh.vertices) < _RESERVED_INDEX
    indices = mesh.triangles.reshape(-1).astype(np.uint16 if uses_16_bit_indices else np.uint32)
    index = add_accessor(indices, "SCALAR", _SHORT if uses_16_bit_indices else _INT, INDEX_TARGET)
    material: JsonObject = {
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
        "doubleSided": True,
    }
    used = [MESH_QUANTIZATION] if grid.in_16_bits else []
    tree: JsonObject = {
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
    if compress:
        used.append(MESHOPT_COMPRESSION)
    if used:
        tree["extensionsRequired"] = list(used)
    if mesh.colors is not None or image is not None:
        material["extensions"] = {UNLIT: {}}
        used.append(UNLIT)
    if used:
        tree["extensionsUsed"] = used
    return _encode_container(tree, views, compress)


def _split_along_seams(mesh: Mesh) -> tuple[Mesh, NDArray[np.uint16] | None]:
    """Duplicate vertices along texture seams.

    Returns
    -------
    The mesh, and 16-bit texture coordinates of its vertices from the upper left corner; None without a
    texture.
    """
    if mesh.texture is None:
        return mesh, None
    places = np.rint((mesh.texture.uvs.reshape(-1, 2) * (1, -1) + (0, 1)) * _MAX_UV)
    u, v = places.clip(0, _MAX_UV).astype(np.int64).T
    wedges, index = np.unique(
        (mesh.triangles.reshape(-1).astype(np.int64) << 32) | (u << 16) | v, return_inverse=True
    )
    split = Mesh(mesh.vertices[wedges >> 32], index.reshape(-1, 3).astype(np.int32))
    return split, np.stack([wedges >> 16 & _MAX_UV, wedges & _MAX_UV], axis=1).astype(np.uint16)


def _reorder_in_strips(mesh: Mesh, uvs: NDArray[np.uint16] | None) -> tuple[Mesh, NDArray[np.uint16] | None]:
    """Reorder triangles, and vertices by first use, for better compression."""
    triangles, order = reorder_for_compression(mesh.triangles, len(mesh.vertices))
    colors = None if mesh.colors is None else mesh.colors[order]
    return Mesh(mesh.vertices[order], triangles, colors), None if uvs is None else uvs[order]


def _add_image(tree: JsonObject, image: Image, view: int) -> list[str]:
    """Add the image of the only material to the glTF tree, in buffer view `view`.

    Returns
    -------
    Names of the extensions that a reader must support.
    """
    texture: JsonObject = {"source": 0}
    is_webp = image.mime == _WEBP_TYPE
    tree["images"] = [{"bufferView": view, "mimeType": image.mime}]
    tree["samplers"] = [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}]
    tree["textures"] = [{"sampler": 0, **({"extensions": {_WEBP: texture}} if is_webp else texture)}]
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    return [_WEBP] if is_webp else []


def _encode_container(tree: JsonObject, views: list[tuple[NDArray[Any], int]], compress: bool) -> bytes:
    """Encode a glTF tree and its buffers as a GLB file.

    As EXT_meshopt_compression requires, compressed views also declare their range in a second buffer, which
    is
    not stored.
    """
    tree["bufferViews"], pieces, size, plain_size = [], [], 0, 0
    for values, target in views:
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        data = values.tobytes()
        stride = values.shape[1] * values.itemsize if target == VERTEX_TARGET else values.itemsize
        view: JsonObject = {"buffer": 0, "byteOffset": size, "byteLength": len(data)}
        if target:
            view["target"] = target
        if target == VERTEX_TARGET:
            view["byteStride"] = stride
        if compress and target:
            view |= {"buffer": 1, "byteOffset": plain_size}
            plain_size += len(data) + -len(data) % 4
            data, mode = compress_buffer(values, target)
            view["extensions"] = {
                MESHOPT_COMPRESSION: {
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
    if compress:
        tree["buffers"].append(
            {"byteLength": plain_size, "extensions": {MESHOPT_COMPRESSION: {"fallback": True}}}
        )
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = b"glTF" + np.array([2, 12 + 8 + len(text) + 8 + size, len(text), _JSON], "<u4").tobytes()
    return b"".join([head, text, np.array([size, _BIN], "<u4").tobytes(), *pieces])
