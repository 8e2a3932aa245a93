"""glTF writer: one primitive per part and material; images are stored unchanged.

Source: Khronos Group, "glTF 2.0 specification", 2021, sections 3.6 (alignment, bounds) and 4 (GLB container).
The format stores single precision. A mesh far from the origin is therefore centred and moved back by its
node's translation. Vertex colours are written as linear light, from which the 8-bit sRGB values are recovered
exactly. For the web, attributes can be quantized and compressed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import MeshError, StageError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.surface.codes import MESH_FILE_TOO_LARGE
from scanloom.stages.surface.finite_check import FLOAT32_MAX
from scanloom.stages.surface.formats.color_conversion import convert_srgb_to_linear
from scanloom.stages.surface.formats.gltf_buffer import GltfBuffer
from scanloom.stages.surface.formats.gltf_container import SCAN_FROM_WORLD, JsonObject
from scanloom.stages.surface.formats.gltf_materials import (
    ImageEncoder,
    MaterialWriter,
    has_images,
    multiplies_colors,
)
from scanloom.stages.surface.formats.gltf_packing import (
    INDEX_TARGET,
    MESH_QUANTIZATION,
    MESHOPT_COMPRESSION,
    VERTEX_TARGET,
    make_quantization_grid,
    quantize_normals,
    quantize_uvs,
    reorder_for_compression,
)
from scanloom.stages.surface.formats.texture_files import write_images
from scanloom.stages.surface.mesh import Mesh, require_writable
from scanloom.stages.surface.texture import Image, Material
from scanloom.stages.surface.up_direction import rotate_to_y
from scanloom.stages.surface.welding import find_first_equal_rows

_FLOAT, _SHORT, _INT, _BYTE, _SIGNED_BYTE = 5126, 5123, 5125, 5121, 5120
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_MAX_GLB_BYTES = 1 << 32
# Ratio of the distance from the origin to the mesh size above which the mesh is centred to keep float32
# precision.
_MAX_RELATIVE_OFFSET = 4.0
# Tolerance of unit length; normals within it are written unchanged.
_UNIT_LENGTH_TOLERANCE = 1e-4

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


def write_gltf(
    path: Path | str,
    mesh: Mesh,
    *,
    compress: str = "none",
    shading: str = "bare",
    position_bits: int = 16,
    texel_steps: int = 0,
    values: NDArray[np.uint8] | None = None,
    encode_image: ImageEncoder | None = None,
) -> None:
    """Write a mesh as .glb, or as .gltf with separate buffer and images.

    Each file is replaced atomically. Triangles are grouped by part and material. Parts that share no vertices
    become separate nodes. If the mesh has an up direction, a root node rotates it to +y, and
    `asset.extras.scan_from_world` stores the inverse rotation.

    Parameters
    ----------
    path : output file; its extension selects the container.
    mesh : mesh in metres.
    compress : one of COMPRESSIONS. `quantize`: positions with up to 65,535 steps along the longest side (the
        step
        is a power of two), normals with 8 bits, texture coordinates inside the image with 16 bits; viewers
        need KHR_mesh_quantization. `meshopt`: the same, losslessly compressed, with triangles and vertices
        reordered; viewers need EXT_meshopt_compression.
    shading : one of SHADINGS. `keep`: as the materials state; vertex colours without a material are lit.
        `bare`:
        the same, but uncompressed files have no material for vertex colours, because trimesh drops colours
        next to a material. `unlit`: colours are displayed without lighting; normals and extensions for
        lighting are dropped; no effect on a mesh without colours. `lit`: overrides the materials.
    position_bits : bits per component of a compressed position, 1 to 16.
    texel_steps : steps of compressed texture coordinates per texel; viewers need KHR_texture_transform. 0 for
        16
        bits per image side, without that extension.
    values : (n, 4) additional 8-bit values per vertex, written as attribute `_VALUES`, which other programs
        ignore.
    encode_image : encoder of all images that the file needs; None stores them unchanged.

    Raises
    ------
    StageError
        If the file cannot be written, or exceeds the 4 GiB limit of GLB.
    MeshError
        If coordinates are not finite or exceed single precision.
    """
    path = Path(path)
    require_writable(mesh, path, single_precision=True)
    tree: JsonObject = {"asset": {"version": "2.0", "generator": "scanloom"}, "scene": 0, "scenes": [{}]}
    if shading == "unlit":
        is_colored = mesh.colors is not None or mesh.texture is not None
        shading = "unlit" if is_colored else "keep"
        mesh = mesh.with_(normals=None, corner_normals=None) if is_colored else mesh
    is_compressed = compress != "none" and len(mesh.triangles) > 0
    # Unreferenced vertices are not written, so they must not enlarge the grid.
    lattice = (
        make_quantization_grid(mesh.vertices[np.unique(mesh.triangles)], position_bits)
        if is_compressed
        else None
    )
    buffer = GltfBuffer(tree, lattice, texel_steps, use_meshopt=is_compressed and compress == "meshopt")
    if is_compressed:
        needed = [MESH_QUANTIZATION, MESHOPT_COMPRESSION] if buffer.uses_meshopt else [MESH_QUANTIZATION]
        tree |= {"extensionsUsed": [*needed], "extensionsRequired": [*needed]}
    materials = MaterialWriter(
        tree, shading, bare_colors=shading == "bare" and not is_compressed, encode_image=encode_image
    )
    _add_nodes(tree, buffer, materials, mesh, values)
    if path.suffix.lower() == ".gltf":
        _write_gltf_with_files(path, tree, buffer, materials)
    else:
        _write_glb(path, tree, buffer, materials)


def _add_nodes(
    tree: JsonObject,
    buffer: GltfBuffer,
    materials: MaterialWriter,
    mesh: Mesh,
    values: NDArray[np.uint8] | None,
) -> None:
    if len(mesh.triangles) == 0:
        return
    lattice = buffer.lattice
    transform: JsonObject = {}
    if lattice is not None:
        transform = {"translation": lattice.origin.tolist(), "scale": [lattice.step] * 3}
    elif (offset := _compute_centering_offset(mesh.vertices)).any():
        mesh = mesh.with_(vertices=mesh.vertices - offset)
        transform = {"translation": offset.tolist()}
    parts = np.full(len(mesh.triangles), -1, np.int32) if mesh.part_ids is None else mesh.part_ids
    one_node = _share_vertices(mesh, parts)
    nodes: dict[int, tuple[str, list[JsonObject]]] = {}
    for part, material, chosen in _group_triangles(mesh, parts):
        name = mesh.part_names[part] if part >= 0 else ""
        of_group = mesh.texture.materials[material] if mesh.texture is not None and material >= 0 else None
        primitive, steps = _add_primitive(buffer, mesh, chosen, of_group, values)
        colored = "COLOR_0" in primitive["attributes"]
        if (number := materials.add_material(of_group, with_colors=colored, steps=steps)) is not None:
            primitive["material"] = number
        if (one_node and name) or (mesh.part_names and not name):
            primitive["extras"] = {"part": name}
        nodes.setdefault(0 if one_node else part, ("" if one_node else name, []))[1].append(primitive)
    tree["nodes"], tree["meshes"] = [], []
    for name, primitives in nodes.values():
        label = {"name": name} if name else {}
        tree["nodes"].append({"mesh": len(tree["meshes"]), **label, **transform})
        tree["meshes"].append({"primitives": primitives, **label})
    tree["scenes"] = [{"nodes": list(range(len(tree["nodes"])))}]
    if mesh.up is not None:
        up = np.array(mesh.up)
        _set_upright(tree, rotate_to_y(up / np.linalg.norm(up)))


def _set_upright(tree: JsonObject, turn: Floats) -> None:
    """Add a root node that rotates the mesh upright, and store the inverse rotation."""
    tree["asset"]["extras"] = {SCAN_FROM_WORLD: _flatten_matrix(turn.T)}
    if not np.array_equal(turn, np.eye(3)):
        tree["nodes"].append({"matrix": _flatten_matrix(turn), "children": tree["scenes"][0]["nodes"]})
        tree["scenes"] = [{"nodes": [len(tree["nodes"]) - 1]}]


def _flatten_matrix(turn: Floats) -> list[float]:
    """Return a rotation (3, 3) as glTF matrix: 16 numbers in column-major order."""
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    return [float(value) for value in matrix.T.reshape(-1)]


def _compute_centering_offset(vertices: Floats) -> Floats:
    """Return the offset (3,) of positions that keeps float32 precision; 0 if none is needed."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = np.rint(low / 2 + high / 2)
    if (
        np.array_equal(vertices.astype(np.float32), vertices)
        or abs(centre).max() < _MAX_RELATIVE_OFFSET * (high - low).max()
    ):
        return np.zeros(3)
    return np.asarray(centre)


def _share_vertices(mesh: Mesh, parts: NDArray[np.int32]) -> bool:
    """Return True if a vertex belongs to two parts.

    As separate nodes, these parts would lose their connection.
    """
    part_of = np.full(len(mesh.vertices), -2, np.int32)
    corner_parts = np.repeat(parts, 3)
    part_of[mesh.triangles.reshape(-1)] = corner_parts
    return bool((part_of[mesh.triangles.reshape(-1)] != corner_parts).any())


def _group_triangles(mesh: Mesh, parts: NDArray[np.int32]) -> Iterator[tuple[int, int, Rows | None]]:
    """Yield part, material and triangle indices of each primitive; None for all triangles.

    Triangles with and without texture coordinates or corner normals go to different primitives.
    """
    count = len(mesh.triangles)
    zero = np.zeros(count, np.int32)
    keys = np.stack((
        parts,
        zero - 1 if mesh.texture is None else mesh.texture.material_ids,
        zero if mesh.texture is None else mesh.texture.has_uvs(),
        zero if mesh.corner_normals is None else (mesh.corner_normals != 0).any(axis=2).all(axis=1),
    ))  # fmt: skip
    if (keys == keys[:, :1]).all():
        yield int(keys[0, 0]), int(keys[1, 0]), None
        return
    order = np.lexsort(keys[::-1])
    ordered = keys[:, order]
    begins = np.flatnonzero((ordered[:, 1:] != ordered[:, :-1]).any(axis=0)) + 1
    # Sorted by first triangle, so that a mesh with contiguous groups keeps its triangle order.
    for chosen in sorted(np.split(order, begins), key=lambda rows: int(rows[0])):
        yield int(keys[0, chosen[0]]), int(keys[1, chosen[0]]), chosen


def _add_primitive(
    buffer: GltfBuffer,
    mesh: Mesh,
    chosen: Rows | None,
    material: Material | None,
    values: NDArray[np.uint8] | None,
) -> tuple[JsonObject, tuple[int, int] | None]:
    """Add the chosen triangles, which must all have the same attributes.

    Returns
    -------
    The JSON of the primitive, and the quantization steps of its texture coordinates along u and v, or None.
    """
    rows: Any = slice(None) if chosen is None else chosen
    triangles = mesh.triangles[rows]
    columns: list[NDArray[Any]] = []
    texture = mesh.texture
    uvs = None
    # A material with images requires coordinates, even if the mesh has none for these triangles.
    if texture is not None and (texture.has_uvs()[rows][:1].any() or has_images(material)):
        uvs = texture.uvs[rows].reshape(-1, 2)
        columns += list(uvs.T)
    normals = None
    if mesh.corner_normals is not None:
        normals = mesh.corner_normals[rows].reshape(-1, 3)
        normals = normals if (normals[:3] != 0).any(axis=1).all() else None
        columns += [] if normals is None else list(normals.T)
    corners = triangles.reshape(-1)
    if columns:
        first = find_first_equal_rows([*columns, corners])
        wedges = np.flatnonzero(first == np.arange(len(first)))
        # Sorted by source vertex, so that reading the file restores the vertex order.
        order = np.argsort(corners[wedges], kind="stable")
        index = np.argsort(order)[np.searchsorted(wedges, first)]
        wedges = wedges[order]
        source = corners[wedges]
    elif chosen is None:
        wedges, index, source = np.zeros(0, np.int64), corners, np.arange(len(mesh.vertices))
    else:
        source, index = np.unique(corners, return_inverse=True)
        wedges = np.zeros(0, np.int64)
    if buffer.uses_meshopt:
        ordered, order = reorder_for_compression(index.reshape(-1, 3).astype(np.int32), len(source))
        index, source = ordered.reshape(-1).astype(np.int64), source[order]
        wedges = wedges[order] if len(wedges) else wedges
    if normals is not None:
        normals = normals[wedges]
    elif mesh.corner_normals is None and mesh.normals is not None:
        normals = mesh.normals[source]
    attributes = {"POSITION": _add_positions(buffer, mesh.vertices[source])}
    if normals is not None and (unit := _normalize_normals(normals)) is not None:
        attributes["NORMAL"] = _add_normals(buffer, unit)
    steps = None
    if uvs is not None:
        attributes["TEXCOORD_0"], steps = _add_uvs(buffer, uvs[wedges] * (1, -1) + (0, 1), material)
    if mesh.colors is not None:
        shown = material is None or material.image is None or multiplies_colors(material)
        attributes |= _add_colors(buffer, mesh.colors[source], is_displayed=shown)
    if values is not None:
        attributes["_VALUES"] = buffer.add_accessor(
            values[source], "VEC4", _BYTE, VERTEX_TARGET, normalized=True
        )
    narrow = len(source) < np.iinfo(np.uint16).max  # 65535 is the primitive-restart index
    indices = index.astype(np.uint16 if narrow else np.uint32).reshape(-1)
    code = _SHORT if narrow else _INT
    return {
        "attributes": attributes,
        "indices": buffer.add_accessor(indices, "SCALAR", code, INDEX_TARGET),
    }, steps


def _add_positions(buffer: GltfBuffer, vertices: Floats) -> int:
    positions: NDArray[Any]
    if buffer.lattice is None:
        positions, code = vertices.astype(np.float32), _FLOAT
    else:
        positions, code = buffer.lattice.quantize(vertices), _SHORT
    bounds = {"min": positions[:, :3].min(axis=0).tolist(), "max": positions[:, :3].max(axis=0).tolist()}
    return buffer.add_accessor(positions, "VEC3", code, VERTEX_TARGET, **bounds)


def _add_normals(buffer: GltfBuffer, unit: NDArray[np.float32]) -> int:
    if buffer.lattice is None:
        return buffer.add_accessor(unit, "VEC3", _FLOAT, VERTEX_TARGET)
    return buffer.add_accessor(quantize_normals(unit), "VEC3", _SIGNED_BYTE, VERTEX_TARGET, normalized=True)


def _add_uvs(
    buffer: GltfBuffer, uvs: Floats, material: Material | None
) -> tuple[int, tuple[int, int] | None]:
    if buffer.lattice is not None:
        steps = _compute_uv_steps(buffer.texel_steps, material)
        if steps is not None and (places := quantize_uvs(uvs, steps)) is not None:
            return buffer.add_accessor(places, "VEC2", _SHORT, VERTEX_TARGET), steps
        if (places := quantize_uvs(uvs)) is not None:
            return buffer.add_accessor(places, "VEC2", _SHORT, VERTEX_TARGET, normalized=True), None
    held = uvs.clip(-FLOAT32_MAX, FLOAT32_MAX).astype(np.float32)
    return buffer.add_accessor(held, "VEC2", _FLOAT, VERTEX_TARGET), None


def _compute_uv_steps(steps_per_texel: int, material: Material | None) -> tuple[int, int] | None:
    """Return the quantization steps along u and v; None without a readable image."""
    if steps_per_texel == 0 or material is None or material.image is None:
        return None
    try:
        height, width = material.image.pixels.shape[:2]
    except MeshError:
        return None
    return steps_per_texel * width, steps_per_texel * height


def _normalize_normals(normals: Floats) -> NDArray[np.float32] | None:
    """Normalize normals to float32; None if some have no finite, positive length."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not (length > 0).all() or not np.isfinite(length).all():
        return None
    return np.where(abs(length - 1) > _UNIT_LENGTH_TOLERANCE, normals / length, normals).astype(np.float32)


def _add_colors(buffer: GltfBuffer, colors: NDArray[np.uint8], *, is_displayed: bool) -> dict[str, int]:
    """Add vertex colours as COLOR_0 or as a private attribute.

    COLOR_0 would darken a material's image.
    """
    if not is_displayed:
        padded = np.pad(colors, ((0, 0), (0, 1)), constant_values=255)
        return {
            "_COLOR_DISPLAYED": buffer.add_accessor(padded, "VEC4", _BYTE, VERTEX_TARGET, normalized=True)
        }
    light = convert_srgb_to_linear(np.arange(256) / 255)
    if buffer.lattice is None:
        # Floats, because some programs misread 16-bit integer colours.
        return {
            "COLOR_0": buffer.add_accessor(light.astype(np.float32)[colors], "VEC3", _FLOAT, VERTEX_TARGET)
        }
    light = np.rint(light * 65535).astype(np.uint16)
    padded = np.pad(light[colors], ((0, 0), (0, 1)), constant_values=65535)
    return {"COLOR_0": buffer.add_accessor(padded, "VEC4", _SHORT, VERTEX_TARGET, normalized=True)}


def _write_glb(path: Path, tree: JsonObject, buffer: GltfBuffer, materials: MaterialWriter) -> None:
    for data, mime, name in materials.images:
        label = {"name": name} if name else {}
        image = {"bufferView": buffer.add_view(data), "mimeType": mime, **label}
        tree.setdefault("images", []).append(image)
    if buffer.size:
        tree["buffers"] = buffer.describe()
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + (8 + buffer.size if buffer.size else 0)
    if size >= _MAX_GLB_BYTES:
        raise StageError(
            MESH_FILE_TOO_LARGE,
            "needs {size:,} bytes, more than the 4 GiB limit of GLB",
            remedy="write PLY.",
            where=path,
            size=size,
        )
    with write_file_atomically(path) as part, part.open("wb") as file:
        file.write(b"glTF" + np.array([2, size, len(text), _JSON], "<u4").tobytes())
        file.write(text)
        if buffer.size:
            file.write(np.array([buffer.size, _BIN], "<u4").tobytes())
            file.writelines(buffer.blocks)


def _write_gltf_with_files(
    path: Path, tree: JsonObject, buffer: GltfBuffer, materials: MaterialWriter
) -> None:
    names = write_images(path, [Image(name, data) for data, _, name in materials.images])
    for name in names.values():
        tree.setdefault("images", []).append({"uri": quote(name)})
    if buffer.size:
        binary = path.with_name(f"{path.stem}.bin")
        tree["buffers"] = buffer.describe(uri=quote(binary.name))
        with write_file_atomically(binary) as part, part.open("wb") as file:
            file.writelines(buffer.blocks)
    with write_file_atomically(path) as part:
        part.write_text(json.dumps(tree, indent=1), encoding="utf-8", newline="\n")
