"""PLY reader and writer: meshes with colours, normals and texture, and coloured point clouds.

Files are not parsed by Open3D, whose reader crashes on some malformed files.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.surface.codes import (
    MESH_CONFIDENCE_LEFT_OUT,
    MESH_FILE_DAMAGED,
    MESH_LEFT_OUT,
    MESH_VALUES_REPLACED,
)
from scanloom.stages.surface.formats.color_conversion import to_uint8
from scanloom.stages.surface.formats.ply_format import ListColumn, PlyHeader, PlyTable, read_tables
from scanloom.stages.surface.formats.ply_texture import (
    make_part_comments,
    read_corner_normals,
    read_parts,
    read_ply_texture,
    write_texture_images,
)
from scanloom.stages.surface.formats.polygon_triangulation import triangulate_polygons
from scanloom.stages.surface.intensity import has_intensity, quantize_intensity, restore_intensity
from scanloom.stages.surface.mesh import Mesh, require_writable, validate_mesh

_COLOR_NAMES = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
# Properties that are used or reported elsewhere, by element, with the name of the element in messages.
_VERTEX_PROPERTIES = (
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "alpha",
    "a",
    "s",
    "t",
    "u",
    "v",
    "texture_u",
    "texture_v",
)
_FACE_PROPERTIES = ("vertex_indices", "vertex_index", "texcoord", "texnumber", "alpha", "a")
_SCANLOOM_FACE_PROPERTIES = ("material_index", "part_index", "corner_normals")
# Used if there are no colours.
_INTENSITY = "intensity"
_COLOR_PROPERTIES = tuple(name for names in _COLOR_NAMES for name in names)
# Measurements that scanloom writes. They are not read, because they need not be true for an edited mesh.
_MEASURED_VERTEX_PROPERTIES = ("frames", "angle", "mean_angle", "pixel", "spread", "deviation", "filled")
_COMPUTED_FACE_PROPERTIES = ("shape_bound", "color_bound", "patch")
_KNOWN_PROPERTIES = {
    "vertex": ("vertices", (*_VERTEX_PROPERTIES, *_COLOR_PROPERTIES, *_MEASURED_VERTEX_PROPERTIES)),
    "face": (
        "faces",
        (*_FACE_PROPERTIES, *_SCANLOOM_FACE_PROPERTIES, *_COLOR_PROPERTIES, *_COMPUTED_FACE_PROPERTIES),
    ),
}
_STRIPS_ELEMENT = "tristrips"
# Maximum number of dropped properties listed by name in the warning.
_MAX_LISTED_NAMES = 5


def read_ply(path: Path | str) -> Mesh:
    """Read a PLY file: text, or binary of either byte order.

    Polygons are triangulated and triangle strips unrolled. Colours can be integers or floats. Without them,
    the property `intensity` of a mesh becomes grey colours of 256 levels; see
    `scanloom.stages.surface.intensity`.
    Texture coordinates per corner (MeshLab's `texcoord`) or per vertex become a Texture with the unchanged
    image files. A point cloud becomes a mesh without triangles. Face colours, alpha, and other properties and
    elements are dropped. `Mesh.diagnostics` lists changed and dropped data.

    Raises
    ------
    InputError
        If the file is not PLY, is damaged, or is shorter than its header states.
    MeshError
        If a vertex is not finite or an index is out of range.
    """
    with collecting() as diagnostics:
        mesh = _read_file(Path(path))
    return mesh.with_(diagnostics=tuple(diagnostics))


def _read_file(path: Path) -> Mesh:
    header, tables = read_tables(path)
    vertex = tables.get("vertex", {})
    vertices = _stack_columns(vertex, ("x", "y", "z"))
    if vertices is None:
        raise InputError(MESH_FILE_DAMAGED, "has no element `vertex` with x, y and z.", path)
    face = tables.get("face", {})
    vertices = vertices.astype(np.float64)
    corners, source, used = _triangulate_faces(face, vertices, path)
    triangles = used[corners] if len(used) else np.zeros((0, 3), np.int32)
    if _STRIPS_ELEMENT in tables and len(triangles) == 0:
        triangles = _unroll_strips(tables[_STRIPS_ELEMENT])
    colors, intensity_max = _read_vertex_colors(vertex, path), None
    # The intensity of a scanner's points depends on range and angle, and is no colour.
    if colors is None and len(triangles):
        colors, intensity_max = _read_intensity(vertex, path)
    mesh = Mesh(
        vertices=vertices,
        triangles=triangles,
        colors=colors,
        normals=_read_normals(vertex, path),
        intensity_max=intensity_max,
    )
    if any(name in face for name in ("red", "diffuse_red", "r")):
        emit(MESH_LEFT_OUT.warning("face colours are left out; only vertex colours are used", path))
    _report_transparency(vertex, path)
    _report_unused_data(header, path, reads_intensity=intensity_max is not None)
    mesh = validate_mesh(mesh, str(path))
    texture = read_ply_texture(header, vertex, face, mesh.triangles, corners, source, path)
    part_ids, part_names = read_parts(header, face, source, len(mesh.triangles))
    return mesh.with_(
        texture=texture,
        corner_normals=read_corner_normals(face, corners),
        part_ids=part_ids,
        part_names=part_names,
    )


def _stack_columns(table: PlyTable, names: tuple[str, ...]) -> NDArray[Any] | None:
    columns = [table.get(name) for name in names]
    if not all(isinstance(column, np.ndarray) for column in columns):
        return None
    return np.stack(columns, axis=1)  # type: ignore[arg-type]


def _read_vertex_colors(vertex: PlyTable, path: Path) -> NDArray[np.uint8] | None:
    for names in _COLOR_NAMES:
        values = _stack_columns(vertex, names)
        if values is not None:
            if not np.isfinite(values).all():
                emit(MESH_VALUES_REPLACED.warning("colours that are not finite become black", path))
            return to_uint8(values)
    return None


def _read_intensity(vertex: PlyTable, path: Path) -> tuple[NDArray[np.uint8] | None, float | None]:
    """Read the intensity as grey colours, and the value of level 255."""
    values = vertex.get(_INTENSITY)
    if not isinstance(values, np.ndarray):
        return None, None
    colors, full_scale = quantize_intensity(values)
    if not np.isfinite(values).all() or values.min(initial=0) < 0:
        emit(MESH_VALUES_REPLACED.warning("intensities that are negative or not finite become 0", path))
    return colors, full_scale


def _report_transparency(vertex: PlyTable, path: Path) -> None:
    for name in ("alpha", "a"):
        alpha = _stack_columns(vertex, (name,))
        if alpha is None or not alpha.size:
            continue
        if alpha.min() < (255 if alpha.dtype.kind in "iu" else 1):
            emit(MESH_LEFT_OUT.warning("the transparency of vertices is left out", path))


def _report_unused_data(header: PlyHeader, path: Path, *, reads_intensity: bool) -> None:
    """Warn about dropped elements, and dropped properties of vertices and faces."""
    for element in header.elements:
        if element.count == 0 or element.name == _STRIPS_ELEMENT:
            continue
        if element.name not in _KNOWN_PROPERTIES:
            emit(MESH_LEFT_OUT.warning("the element {name!r} is left out", path, name=element.name))
            continue
        called, known_names = _KNOWN_PROPERTIES[element.name]
        unused_names = [one.name for one in element.properties if one.name not in known_names]
        if called == "vertices" and reads_intensity:
            unused_names.remove(_INTENSITY)
        if called == "vertices" and "confidence" in unused_names:
            unused_names.remove("confidence")
            emit(
                MESH_CONFIDENCE_LEFT_OUT.warning(
                    "the vertex confidence is left out: only remesh uses it", path
                )
            )
        if unused_names:
            more = (
                f" and {len(unused_names) - _MAX_LISTED_NAMES:,} more"
                if len(unused_names) > _MAX_LISTED_NAMES
                else ""
            )
            emit(
                MESH_LEFT_OUT.warning(
                    "properties of its {called} are left out: {names}",
                    path,
                    called=called,
                    names=", ".join(unused_names[:_MAX_LISTED_NAMES]) + more,
                )
            )


def _read_normals(vertex: PlyTable, path: Path) -> NDArray[np.float64] | None:
    normals = _stack_columns(vertex, ("nx", "ny", "nz"))
    if normals is not None and not np.isfinite(normals).all():
        emit(MESH_LEFT_OUT.warning("normals are left out: some are not finite", path))
        return None
    return normals


def _triangulate_faces(
    face: PlyTable, vertices: NDArray[np.float64], path: Path
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any]]:
    """Triangulate the faces; return the result of split_polygons and all corners' vertex indices."""
    lists = face.get("vertex_indices", face.get("vertex_index"))
    if not isinstance(lists, ListColumn):
        nothing = np.zeros(0, np.int64)
        return nothing.reshape(0, 3), nothing, nothing
    indices = lists.values.astype(np.int64)
    return (*triangulate_polygons(lists.lengths, indices, vertices, path), indices)


def _unroll_strips(strips: PlyTable) -> NDArray[np.int64]:
    """Unroll triangle strips to triangles (m, 3) with consistent orientation.

    An index of -1 ends a strip.
    """
    nothing = np.zeros((0, 3), np.int64)
    lists = strips.get("vertex_indices", strips.get("vertex_index"))
    if not isinstance(lists, ListColumn):
        return nothing
    chain = np.insert(lists.values.astype(np.int64), np.cumsum(lists.lengths), -1)
    if len(chain) < 3:
        return nothing
    position = np.arange(len(chain))
    start = np.maximum.accumulate(np.where(chain == -1, position + 1, 0))
    triangles = np.stack((chain[:-2], chain[1:-1], chain[2:]), axis=1)
    odd = (position - start)[:-2] % 2 == 1
    triangles[odd] = triangles[odd][:, [1, 0, 2]]
    a, b, c = triangles.T
    # Degenerate triangles connect strips and are dropped.
    real = (triangles != -1).all(axis=1) & (a != b) & (b != c) & (c != a)
    return np.asarray(triangles[real])


def read_vertex_values(path: Path | str, name: str) -> NDArray[np.float64] | None:
    """Read a vertex property (n,) that `read_ply` drops; None if absent.

    Raises
    ------
    InputError
        As `read_ply`.
    """
    _, tables = read_tables(Path(path))
    values = tables.get("vertex", {}).get(name)
    return values.astype(np.float64) if isinstance(values, np.ndarray) else None


def write_ply(
    path: Path | str,
    mesh: Mesh,
    face_values: Mapping[str, NDArray[np.float64]] | None = None,
    vertex_values: Mapping[str, NDArray[np.float64]] | None = None,
) -> None:
    """Write a mesh as binary little-endian PLY; reading it back is lossless.

    Grey colours that come from an intensity are written as `intensity`, in the unit of the file. Values are
    stored as 32-bit floats if that is lossless (as for fused meshes), else as doubles. MeshLab, Blender,
    CloudCompare, Open3D and trimesh read both. Texture images are written to the same folder, with
    unchanged names and bytes. Each file is replaced atomically.

    Parameters
    ----------
    path : output file.
    mesh : mesh in metres.
    face_values : additional face properties by name, (m,) each; `read_ply` ignores them.
    vertex_values : additional vertex properties by name, (n,) each; `read_ply` ignores them.

    Raises
    ------
    MeshError
        If coordinates are not finite.
    StageError
        If a file cannot be written.
    """
    path = Path(path)
    require_writable(mesh, path)
    comments: list[str] = []
    face: list[tuple[str, NDArray[Any]]] = [("vertex_indices", mesh.triangles.astype("<i4"))]
    if mesh.texture is not None:
        comments, texnumber, has_materials = write_texture_images(path, mesh.texture)
        face.append(("texcoord", _narrow_floats(mesh.texture.uvs.reshape(-1, 6))))
        face.append(("texnumber", texnumber.astype("<i4")))
        if has_materials:
            face.append(("material_index", mesh.texture.material_ids.astype("<i4")))
    if mesh.corner_normals is not None:
        face.append(("corner_normals", _narrow_floats(mesh.corner_normals.reshape(-1, 9))))
    if mesh.part_ids is not None:
        comments += make_part_comments(mesh.part_names)
        face.append(("part_index", mesh.part_ids.astype("<i4")))
    face += [(name, _narrow_floats(values)) for name, values in (face_values or {}).items()]
    is_grey = has_intensity(mesh)
    vertex = _make_vertex_columns(mesh.vertices, None if is_grey else mesh.colors, mesh.normals)
    if is_grey:
        values = restore_intensity(mesh)
        vertex.append((_INTENSITY, values if values.dtype == np.uint8 else values.astype("<f4")))
    vertex += [(name, _narrow_floats(values)) for name, values in (vertex_values or {}).items()]
    _write_tables(path, comments, {"vertex": vertex, "face": face})


def write_ply_cloud(path: Path | str, points: ArrayLike, colors: ArrayLike | None = None) -> None:
    """Write a point cloud as binary little-endian PLY.

    Parameters
    ----------
    points : (n, 3), metres.
    colors : (n, 3) uint8 RGB, or None.

    Raises
    ------
    MeshError
        If shapes are wrong or points are not finite.
    StageError
        If the file cannot be written.
    """
    cloud = validate_mesh(
        Mesh(np.asarray(points), np.zeros((0, 3), np.int32), _convert_optional(colors)), "points"
    )
    _write_tables(Path(path), [], {"vertex": _make_vertex_columns(cloud.vertices, cloud.colors, None)})


def _convert_optional(values: ArrayLike | None) -> Any:
    return None if values is None else np.asarray(values)


def _make_vertex_columns(
    vertices: NDArray[np.float64], colors: NDArray[np.uint8] | None, normals: NDArray[np.float64] | None
) -> list[tuple[str, NDArray[Any]]]:
    columns: list[tuple[str, NDArray[Any]]] = list(zip("xyz", _narrow_floats(vertices).T, strict=True))
    if normals is not None:
        columns += zip(("nx", "ny", "nz"), _narrow_floats(normals).T, strict=True)
    if colors is not None:
        columns += zip(_COLOR_NAMES[0], colors.T, strict=True)
    return columns


def _narrow_floats(values: NDArray[np.float64]) -> NDArray[Any]:
    """Convert to little-endian float32 if lossless, else to little-endian float64."""
    with np.errstate(over="ignore"):
        narrow = values.astype("<f4")
    return narrow if np.array_equal(narrow, values) else values.astype("<f8")


_PLY_TYPES = {"u1": "uchar", "i4": "int", "f4": "float", "f8": "double"}


def _write_tables(path: Path, comments: list[str], tables: dict[str, list[tuple[str, NDArray[Any]]]]) -> None:
    """Write elements given as columns; a 2-D column becomes a list property."""
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {c}" for c in comments)]
    blocks = []
    for element, columns in tables.items():
        lines.append(f"element {element} {len(columns[0][1])}")
        row: list[tuple[str, Any] | tuple[str, Any, tuple[int]]] = []
        for name, values in columns:
            kind = _PLY_TYPES[values.dtype.str[1:]]
            if values.ndim == 2:
                lines.append(f"property list uchar {kind} {name}")
                row += [(f"{name} length", "u1"), (name, values.dtype, values.shape[1:])]
            else:
                lines.append(f"property {kind} {name}")
                row.append((name, values.dtype))
        rows = np.empty(len(columns[0][1]), row)
        for name, values in columns:
            if values.ndim == 2:
                rows[f"{name} length"] = values.shape[1]
            rows[name] = values
        blocks.append(rows)
    header = "\n".join([*lines, "end_header", ""]).encode()
    with write_file_atomically(path) as part, part.open("wb") as file:
        file.write(header)
        for rows in blocks:
            file.write(rows.data)
