"""glTF reader: merges all meshes of the scene, with node transforms applied.

Coordinates are kept in metres, y-up. Exception: if `asset.extras` of the file stores the rotation back to
scan axes, that rotation is applied, and `Mesh.up` holds the up direction. Vertex colours are converted from
linear light to sRGB, except for generators known to write sRGB. Animations, skins, morph targets, points and
lines are dropped with a warning.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Code
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface.codes import (
    MESH_COMPRESSION_UNKNOWN,
    MESH_FILE_DAMAGED,
    MESH_LEFT_OUT,
    MESH_TEXTURE_DAMAGED,
    MESH_VALUES_REPLACED,
)
from scanloom.stages.surface.formats.color_conversion import convert_linear_to_srgb, to_uint8
from scanloom.stages.surface.formats.gltf_container import (
    SCAN_FROM_WORLD,
    UNSUPPORTED_COMPRESSIONS,
    Gltf,
    JsonObject,
    read_container,
)
from scanloom.stages.surface.formats.gltf_materials import MaterialReader, UvPlacement
from scanloom.stages.surface.mesh import Mesh, validate_mesh
from scanloom.stages.surface.texture import Texture
from scanloom.stages.surface.welding import weld_vertices

# Generators that write vertex colours as sRGB, contrary to the specification.
_SRGB_GENERATORS = ("https://github.com/mikedh/trimesh", "Open3D")
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
# Attributes that are read, reported elsewhere, or written by scanloom in addition to standard ones.
_KNOWN_ATTRIBUTES = re.compile(
    r"POSITION|NORMAL|TANGENT|TEXCOORD_\d+|COLOR_0|JOINTS_\d+|WEIGHTS_\d+|_COLOR_DISPLAYED|_VALUES"
)
# Tolerance of the orthonormality test of a rotation matrix.
_ROTATION_TOLERANCE = 1e-6
# Many nodes can instance one large mesh. More corners and vertices than this exceed memory and indicate a
# damaged or malicious file.
_MAX_CORNERS = 1 << 29

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass
class _PrimitiveMesh:
    """Mesh of one primitive, with the node transform applied."""

    vertices: Floats
    triangles: Any  # (k, 3), 64 bits until the range is checked
    colors: NDArray[np.uint8] | None
    normals: Floats | None
    uvs: Floats | None
    material: int
    node: int
    name: str


@dataclass
class _ReaderState:
    """State of reading one file."""

    gltf: Gltf
    materials: MaterialReader
    corner_count: int = 0

    def warn(self, message: str, code: Code = MESH_LEFT_OUT, **values: Any) -> None:
        emit(code.warning(message, self.gltf.path, **values))


def read_gltf(path: Path | str) -> Mesh:
    """Read a .glb or .gltf file.

    Vertices of one node with equal position and colour are welded, because glTF duplicates vertices along
    seams. If normals differ at such a vertex, they become corner normals, and the vertex gets their mean.
    Nodes become parts. `Mesh.diagnostics` lists dropped data.

    Raises
    ------
    InputError
        If the file is damaged, refers to a missing buffer, or is compressed with Draco.
    MeshError
        If a vertex is not finite or an index is out of range.
    """
    path = Path(path)
    try:
        gltf = read_container(path)
        # Non-finite values raise or are dropped at the place of use, so NumPy's warnings add nothing.
        with np.errstate(all="ignore"), collecting() as diagnostics:
            mesh = _read_scene(gltf)
        return mesh.with_(diagnostics=tuple(diagnostics))
    # Look-ups in a malformed JSON description can raise any of these.
    except (
        KeyError,
        IndexError,
        TypeError,
        ValueError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as error:
        raise InputError(
            MESH_FILE_DAMAGED,
            "cannot be read as glTF: its JSON description is damaged",
            path,
            remedy="get a whole copy of it.",
        ) from error


def _read_scene(gltf: Gltf) -> Mesh:
    reading = _ReaderState(gltf, MaterialReader(gltf))
    for name in ("animations", "skins", "cameras"):
        if gltf.get_list(name):
            reading.warn("{name} are left out", name=name)
    extensions = gltf.tree.get("extensions")
    if isinstance(extensions, dict) and extensions:
        names = ", ".join(sorted(extensions))
        reading.warn("data of the extensions {names} is left out", names=names)
    parts: list[_PrimitiveMesh] = []
    turn = _read_scan_rotation(reading)
    nodes = _collect_mesh_nodes(gltf, np.eye(4) if turn is None else turn)
    for number, (node, matrix) in enumerate(nodes):
        mesh = gltf.get_item("meshes", node["mesh"])
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            reading.warn("instances of EXT_mesh_gpu_instancing are left out, except one")
        name = str(node.get("name") or mesh.get("name") or ("" if len(nodes) == 1 else f"node {number}"))
        found = (
            _read_primitive(reading, primitive, matrix, number, name) for primitive in mesh["primitives"]
        )
        parts += [part for part in found if part is not None]
    assembled = _merge_primitives(reading, parts)
    if turn is None:
        return assembled
    x, y, z = turn[:3, 1].tolist()
    return assembled.with_(up=(x, y, z))


def _read_scan_rotation(reading: _ReaderState) -> Floats | None:
    """Return the rotation (4, 4) from world to scan axes; None if the file has none."""
    extras = reading.gltf.tree["asset"].get("extras")
    given = extras.get(SCAN_FROM_WORLD) if isinstance(extras, dict) else None
    if given is None:
        return None
    matrix = _parse_rotation(given)
    if matrix is None:
        reading.warn("{name} is left out: it is not a rotation", name=SCAN_FROM_WORLD)
    return matrix


def _parse_rotation(given: Any) -> Floats | None:
    try:
        matrix = np.array(given, float).reshape(4, 4).T
    except (ValueError, TypeError):
        return None
    rotation = matrix[:3, :3]
    if (
        not np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROTATION_TOLERANCE)
        or np.linalg.det(rotation) < 0
    ):
        return None
    expected = np.eye(4)
    expected[:3, :3] = rotation
    return expected if np.array_equal(matrix, expected) else None


def _collect_mesh_nodes(gltf: Gltf, world: Floats) -> list[tuple[JsonObject, Floats]]:
    """Return the nodes with a mesh, and their transforms (4, 4).

    Nodes are in scene order. `world` (4, 4) is applied to the whole scene.
    """
    nodes, scenes = gltf.get_list("nodes"), gltf.get_list("scenes")
    if scenes:
        roots = gltf.get_item("scenes", gltf.tree.get("scene", 0)).get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [number for number in range(len(nodes)) if number not in children]
    found = []
    stack = [(number, world) for number in reversed(roots)]
    visited: set[int] = set()
    while stack:
        number, parent = stack.pop()
        if number in visited:
            raise ValueError("a node has two parents")
        visited.add(number)
        node = gltf.get_item("nodes", number)
        own = _read_node_matrix(node)
        # A root rotation that `world` inverts must cancel exactly; the float product would not.
        is_inverse = number in roots and np.array_equal(own, world.T)
        matrix = np.eye(4) if is_inverse else parent @ own
        if "mesh" in node:
            found.append((node, matrix))
        stack += [(child, matrix) for child in reversed(node.get("children", []))]
    return found


def _read_node_matrix(node: JsonObject) -> Floats:
    if "matrix" in node:
        return np.asarray(np.array(node["matrix"], float).reshape(4, 4).T)
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), float).reshape(4)
    rotation = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    matrix[:3, :3] = rotation * np.array(node.get("scale", (1, 1, 1)), float).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", (0, 0, 0)), float).reshape(3)
    return matrix


def _read_primitive(
    reading: _ReaderState, primitive: JsonObject, matrix: Floats, node: int, name: str
) -> _PrimitiveMesh | None:
    gltf = reading.gltf
    mode = primitive.get("mode", _TRIANGLES)
    attributes = primitive["attributes"]
    if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in attributes:
        reading.warn("points and lines are left out")
        return None
    compressed = any(key in UNSUPPORTED_COMPRESSIONS for key in primitive.get("extensions", {}))
    if compressed and "bufferView" not in gltf.get_item("accessors", attributes["POSITION"]):
        raise InputError(
            MESH_COMPRESSION_UNKNOWN,
            "uses an unsupported compression",
            gltf.path,
            remedy="write it again without compression.",
        )
    if "targets" in primitive:
        reading.warn("morph targets are left out")
    if "TANGENT" in attributes:
        reading.warn("tangents are left out: programs derive them from normals and texture coordinates")
    others = [name for name in attributes if not _KNOWN_ATTRIBUTES.fullmatch(name)]
    if others:
        reading.warn("attributes {names} are left out", names=", ".join(sorted(others)))
    vertices = gltf.read_accessor(attributes["POSITION"])[:, :3].astype(np.float64)
    triangles = _read_triangles(gltf, primitive, mode, len(vertices))
    reading.corner_count += triangles.size + len(vertices)
    if reading.corner_count > _MAX_CORNERS:
        raise InputError(
            MESH_FILE_DAMAGED,
            "its nodes have more than {most_corners:,} corners and vertices; it is damaged.",
            gltf.path,
            most_corners=_MAX_CORNERS,
        )
    vertices, triangles, normal_matrix = _apply_transform(vertices, triangles, matrix)
    colors = _read_colors(reading, attributes, len(vertices))
    material, placement = reading.materials.read_material(
        primitive.get("material"), with_colors=colors is not None
    )
    extras = primitive.get("extras")
    if isinstance(extras, dict) and isinstance(extras.get("part"), str):
        name = extras["part"]
    return _PrimitiveMesh(
        vertices,
        triangles,
        colors,
        _read_normals(reading, attributes, normal_matrix, len(vertices)),
        _read_uvs(reading, attributes, placement, len(vertices)),
        material,
        node,
        name,
    )


def _read_triangles(gltf: Gltf, primitive: JsonObject, mode: int, count: int) -> Rows:
    if "indices" in primitive:
        indices = gltf.read_accessor(primitive["indices"])[:, 0].astype(np.int64)
    else:
        indices = np.arange(count)
    if mode == _TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    first = np.arange(max(len(indices) - 2, 0))
    if mode == _FAN:
        corners = np.stack((first + 1, first + 2, np.zeros_like(first)), axis=1)
    else:
        odd = first % 2
        corners = np.stack((first, first + 1 + odd, first + 2 - odd), axis=1)
    triangles = indices[corners]
    a, b, c = triangles.T
    # Degenerate triangles connect strips and are dropped.
    return np.asarray(triangles[(a != b) & (b != c) & (c != a)])


def _apply_transform(vertices: Floats, triangles: Rows, matrix: Floats) -> tuple[Floats, Rows, Floats]:
    """Apply a node transform; return vertices, triangles and the matrix for normals.

    Triangles are flipped if the transform mirrors.
    """
    linear, translation = matrix[:3, :3], matrix[:3, 3]
    if not np.array_equal(linear, np.eye(3)):
        vertices = vertices @ linear.T
    if translation.any():
        vertices = vertices + translation
    # The cofactor matrix is the inverse transpose times the determinant, and exists for singular matrices
    # too.
    cofactors = np.stack([np.cross(linear[k - 2], linear[k - 1]) for k in range(3)])
    if np.linalg.det(linear) < 0:
        return vertices, triangles[:, [0, 2, 1]], -cofactors
    return vertices, triangles, cofactors


def _read_attribute(
    reading: _ReaderState, attributes: JsonObject, name: str, columns: int, count: int
) -> Floats | None:
    if name not in attributes:
        return None
    values = reading.gltf.read_accessor(attributes[name])
    if len(values) != count or values.shape[1] < columns:
        reading.warn("{name} is left out: it does not match the vertices", name=name)
        return None
    return values


def _read_colors(reading: _ReaderState, attributes: JsonObject, count: int) -> NDArray[np.uint8] | None:
    values = _read_attribute(reading, attributes, "_COLOR_DISPLAYED", 3, count)
    if values is not None:
        return to_uint8(values[:, :3])
    values = _read_attribute(reading, attributes, "COLOR_0", 3, count)
    if values is None:
        return None
    if not np.isfinite(values).all():
        reading.warn("colours that are not finite become black", MESH_VALUES_REPLACED)
    if values.shape[1] == 4 and (values[:, 3] < 1).any():
        reading.warn("the transparency of vertices is left out")
    unit = np.nan_to_num(values[:, :3].astype(np.float64), nan=0, posinf=0, neginf=0).clip(0, 1)
    generator = str(reading.gltf.tree["asset"].get("generator", ""))
    return to_uint8(unit if generator.startswith(_SRGB_GENERATORS) else convert_linear_to_srgb(unit))


def _read_normals(reading: _ReaderState, attributes: JsonObject, matrix: Floats, count: int) -> Floats | None:
    normals = _read_attribute(reading, attributes, "NORMAL", 3, count)
    if normals is None:
        return None
    normals = normals[:, :3].astype(np.float64)
    if not np.array_equal(matrix, np.eye(3)):
        normals = normals @ matrix.T
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.where(length == 0, 1, length)
    if not np.isfinite(normals).all():
        reading.warn("normals that are not finite are left out")
        normals[~np.isfinite(normals).all(axis=1)] = 0
    return normals


def _read_uvs(
    reading: _ReaderState, attributes: JsonObject, placement: UvPlacement, count: int
) -> Floats | None:
    sets = [name for name in attributes if name.startswith("TEXCOORD_")]
    wanted = f"TEXCOORD_{placement.uv_set}"
    others = sorted(set(sets) - {wanted})
    if others:
        reading.warn(
            "texture coordinates {names} are left out: only one set is supported", names=", ".join(others)
        )
    uvs = _read_attribute(reading, attributes, wanted, 2, count)
    if uvs is None:
        return None
    uvs = placement.apply(uvs[:, :2].astype(np.float64))
    uvs[:, 1] = 1 - uvs[:, 1]
    return uvs


def _merge_primitives(reading: _ReaderState, parts: list[_PrimitiveMesh]) -> Mesh:
    """Merge all primitives to one mesh and weld the duplicated vertices of each node."""
    if not parts:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    for part in parts:
        validate_mesh(Mesh(part.vertices, part.triangles), str(reading.gltf.path))
    counts = [len(part.vertices) for part in parts]
    starts = np.cumsum([0, *counts])
    placed = [part.triangles + start for part, start in zip(parts, starts, strict=False)]
    triangles = np.concatenate(placed).astype(np.int32)
    colors = _concatenate_filled([part.colors for part in parts], counts, 255)
    if any(part.colors is None for part in parts) and colors is not None:
        reading.warn("parts without vertex colours become white", MESH_VALUES_REPLACED)
    normals = _concatenate_filled([part.normals for part in parts], counts, 0)
    corner_normals = None if normals is None else normals[triangles]
    names = list(dict.fromkeys((part.node, part.name) for part in parts if part.name))
    numbers = {name: number for number, name in enumerate(names)}
    part_ids = _repeat_per_triangle([numbers.get((part.node, part.name), -1) for part in parts], parts)
    mesh = Mesh(
        np.concatenate([part.vertices for part in parts]),
        triangles,
        colors,
        normals,
        texture=_merge_textures(reading, parts),
        part_ids=part_ids if names else None,
        part_names=tuple(name for _, name in names),
    )
    mesh = weld_vertices(mesh, group_ids=np.repeat([part.node for part in parts], counts))
    if corner_normals is None or mesh.normals is None:
        return mesh
    if any(part.normals is None for part in parts):
        return mesh.with_(normals=None, corner_normals=corner_normals)
    same = np.array_equal(mesh.normals[mesh.triangles], corner_normals)
    return mesh if same else mesh.with_(corner_normals=corner_normals)


def _merge_textures(reading: _ReaderState, parts: list[_PrimitiveMesh]) -> Texture | None:
    materials = tuple(reading.materials.materials)
    uvs = _concatenate_filled(
        [None if part.uvs is None else part.uvs[part.triangles] for part in parts],
        [len(part.triangles) for part in parts],
        0,
    )
    if uvs is None and not materials:
        return None
    ids = _repeat_per_triangle([part.material for part in parts], parts)
    if uvs is None:
        uvs = np.zeros((len(ids), 3, 2))
    finite = np.isfinite(uvs).all(axis=(1, 2))
    if not finite.all():
        lost = np.count_nonzero(~finite)
        reading.warn(
            "{count:,} triangles lose their texture: their texture coordinates are not finite",
            MESH_TEXTURE_DAMAGED,
            count=lost,
        )
        uvs[~finite] = 0
    return Texture(uvs, ids, materials)


def _concatenate_filled(arrays: list[Any], counts: list[int], value: float) -> Any:
    """Concatenate arrays, filling missing ones with `value`; None if all are missing."""
    template = next((array for array in arrays if array is not None), None)
    if template is None:
        return None
    return np.concatenate(
        [
            np.full((count, *template.shape[1:]), value, template.dtype) if array is None else array
            for array, count in zip(arrays, counts, strict=True)
        ]
    )


def _repeat_per_triangle(numbers: list[int], parts: list[_PrimitiveMesh]) -> NDArray[np.int32]:
    return np.repeat(np.array(numbers, np.int32), [len(part.triangles) for part in parts])
