"""Mesh file reader and writer: PLY, OBJ, OFF, STL and glTF.

PLY, OBJ and glTF have parsers in this package. OFF and STL are parsed by trimesh: its exceptions are
converted to one InputError, and files shorter than declared are refused before memory is allocated.
"""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError, UsageError, is_out_of_memory
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.blas_memory import reserve_blas_buffers
from scanloom.stages.files.codes import FILE_PATH_INVALID, FILE_UNREADABLE
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.files.path_safety import resolve_path
from scanloom.stages.surface.codes import (
    MESH_COMPRESSION_UNKNOWN,
    MESH_FILE_DAMAGED,
    MESH_LEFT_OUT,
    MESH_NO_SURFACE,
    USAGE_EXTENSION_UNKNOWN,
)
from scanloom.stages.surface.formats.gltf import read_gltf
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.formats.obj import read_obj, write_obj
from scanloom.stages.surface.formats.ply import read_ply, write_ply
from scanloom.stages.surface.mesh import Mesh, require_writable
from scanloom.stages.surface.mesh_conversion import as_mesh, to_trimesh
from scanloom.stages.surface.welding import weld_vertices

MESH_EXTENSIONS = (".ply", ".obj", ".off", ".stl", ".glb", ".gltf")
# Formats that store geometry only.
GEOMETRY_ONLY_EXTENSIONS = (".off", ".stl")


def read_mesh(path: Path | str) -> Mesh:
    """Read a mesh file; the extension selects the format.

    All objects of a file become one mesh, with scene transforms applied. STL does not share vertices, and
    glTF duplicates them along texture seams; vertices of equal position and colour are therefore welded.

    Parameters
    ----------
    path : mesh file with an extension of EXTENSIONS.

    Returns
    -------
    Mesh
        With at least one triangle; `diagnostics` lists changed and dropped data.

    Raises
    ------
    InputError
        If the file is missing, of an unknown format, damaged, or holds no triangles.
    MeshError
        If a vertex is not finite or an index is out of range.
    """
    path = Path(path)
    mesh = read_mesh_or_empty(path)
    if len(mesh.vertices) == 0:
        raise InputError(MESH_NO_SURFACE, "holds no vertices.", path)
    if len(mesh.triangles) == 0:
        raise InputError(
            MESH_NO_SURFACE,
            "holds {vertices_count:,} vertices but no triangles; a mesh is expected.",
            path,
            vertices_count=len(mesh.vertices),
        )
    return mesh


def read_mesh_or_empty(path: Path) -> Mesh:
    """Read a mesh file like `read_mesh`, but accept files without triangles or vertices."""
    reserve_blas_buffers(1)
    extension = path.suffix.lower()
    if extension not in MESH_EXTENSIONS:
        raise InputError(
            USAGE_EXTENSION_UNKNOWN,
            "is of an unknown format {path_suffix!r}; known are {extensions}.",
            path,
            path_suffix=path.suffix,
            extensions=", ".join(MESH_EXTENSIONS),
        )
    if not path.is_file():
        raise InputError(
            FILE_PATH_INVALID, "does not exist." if not path.exists() else "is not a file.", path
        )
    if extension == ".ply":
        return read_ply(path)
    if extension == ".obj":
        return read_obj(path)
    if extension in (".glb", ".gltf"):
        return read_gltf(path)
    with collecting() as diagnostics:
        mesh = _read_with_trimesh(path, extension)
    return mesh.with_(diagnostics=tuple(diagnostics))


def set_default_up(path: Path, mesh: Mesh) -> Mesh:
    """Set a missing up direction to the format's up axis: +y in glTF."""
    if mesh.up is None and path.suffix.lower() in (".glb", ".gltf"):
        return mesh.with_(up=(0.0, 1.0, 0.0))
    return mesh


def write_mesh(path: Path | str, mesh: Mesh) -> None:
    """Write a mesh; the extension selects the format. The file is replaced atomically.

    PLY and OBJ store every field of a Mesh losslessly. glTF uses single precision and groups triangles by
    part and material. Material properties other than image and base colour are kept only from OBJ to OBJ and
    from glTF to glTF. OFF and STL store geometry only.

    Parameters
    ----------
    path : output file with an extension of EXTENSIONS.
    mesh : mesh in metres.

    Raises
    ------
    UsageError
        If the extension is not in EXTENSIONS.
    MeshError
        If positions, normals or texture coordinates are not finite, or exceed the format's precision.
    StageError
        If a file cannot be written.
    """
    path = Path(path)
    extension = path.suffix.lower()
    if extension not in MESH_EXTENSIONS:
        raise UsageError(
            USAGE_EXTENSION_UNKNOWN,
            "meshes are written as {extensions}, not as {path_suffix!r}.",
            path,
            extensions=", ".join(MESH_EXTENSIONS),
            path_suffix=path.suffix,
        )
    if path.is_symlink():
        # Images and materials must be written next to the link's target.
        path = resolve_path(path)
    if extension == ".ply":
        write_ply(path, mesh)
    elif extension == ".obj":
        write_obj(path, mesh)
    elif extension in (".glb", ".gltf"):
        write_gltf(path, mesh)
    else:
        require_writable(mesh, path, single_precision=extension == ".stl")
        data = to_trimesh(mesh.with_(texture=None))
        with _suppress_warnings():
            written = cast("str | bytes", data.export(file_type=extension[1:]))
        with write_file_atomically(path) as part:
            part.write_bytes(written.encode() if isinstance(written, str) else written)


def list_unsupported_data(extension: str, mesh: Mesh) -> str:
    """Name the mesh data that a format cannot store, such as "colours and parts".

    Empty if nothing is lost. Vertex normals are not listed, because programs recompute them from the
    geometry.
    """
    if extension not in GEOMETRY_ONLY_EXTENSIONS:
        return ""
    has = (
        ("colours", mesh.colors is not None or mesh.texture is not None),
        ("parts", mesh.part_ids is not None),
        ("corner normals", mesh.corner_normals is not None),
    )
    return " and ".join(name for name, there in has if there)


@contextmanager
def _suppress_warnings() -> Iterator[None]:
    # Silences NumPy and trimesh warnings about invalid values; the result is validated afterwards.
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _read_with_trimesh(path: Path, extension: str) -> Mesh:
    try:
        data = read_input_bytes(path)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {strerror}.", path, strerror=error.strerror
        ) from error
    if extension == ".stl":
        _require_complete_stl(data, path)
    elif data[:64].split(b"\n")[0].split()[:2] == [b"OFF", b"BINARY"]:
        raise InputError(
            MESH_COMPRESSION_UNKNOWN,
            "is binary OFF, which is not supported",
            path,
            remedy="write it as text, or as PLY.",
        )
    import trimesh

    try:
        with _suppress_warnings():
            scene = trimesh.load_scene(io.BytesIO(data), file_type=extension[1:], process=False)
            parts = [_apply_scene_transform(scene, node) for node in scene.graph.nodes_geometry]
    except Exception as error:  # trimesh's readers raise arbitrary exceptions on malformed files
        if is_out_of_memory(error):
            raise
        raise InputError(
            MESH_FILE_DAMAGED,
            "cannot be read as {extension}: it is empty, damaged or cut short",
            path,
            remedy="get a whole copy of it.",
            extension=extension[1:].upper(),
        ) from error
    meshes = [as_mesh(part, str(path)) for part in parts if isinstance(part, trimesh.Trimesh)]
    if extension == ".stl":
        _report_unused_stl_data(parts, path)
        return weld_vertices(_concatenate_meshes(meshes))
    _report_unused_off_data(data, path)
    return _concatenate_meshes(meshes)


def _report_unused_off_data(data: bytes, path: Path) -> None:
    """Warn about additional numbers in an OFF file, which trimesh ignores.

    They follow the coordinates of a vertex or the corners of a face.
    """
    lines = data.decode("utf-8", "replace").splitlines()
    text = "\n".join(line.partition("#")[0] for line in lines).partition("OFF")[2]
    rows = [words for line in text.splitlines() if (words := line.split())]
    try:
        vertices, faces = int(rows[0][0]), int(rows[0][1])
        sizes = [int(row[0]) + 1 for row in rows[1 + vertices : 1 + vertices + faces]]
    except (IndexError, ValueError):
        return  # trimesh splits some files in another way
    for called, there in (
        ("vertices", any(len(row) > 3 for row in rows[1 : 1 + vertices])),
        ("faces", any(len(row) > size for row, size in zip(rows[1 + vertices :], sizes, strict=False))),
    ):
        if there:
            emit(
                MESH_LEFT_OUT.warning(
                    "additional numbers of its {called}, such as colours, are left out", path, called=called
                )
            )


def _report_unused_stl_data(parts: list[Any], path: Path) -> None:
    """Warn about dropped solid names and attribute numbers of an STL file."""
    if len(parts) > 1:
        emit(
            MESH_LEFT_OUT.warning(
                "the names of its {count:,} solids are left out: they become one mesh", path, count=len(parts)
            )
        )
    if any(np.any(part.face_attributes.get("stl", 0)) for part in parts):
        emit(
            MESH_LEFT_OUT.warning(
                "attribute numbers of triangles, which some programs use for colours, are left out", path
            )
        )


def _apply_scene_transform(scene: Any, node: str) -> Any:
    transform, name = scene.graph[node]
    part = scene.geometry[name].copy(include_cache=True)
    part.apply_transform(transform)
    return part


def _concatenate_meshes(meshes: list[Mesh]) -> Mesh:
    """Concatenate the meshes of an STL or OFF file.

    Colours are dropped if there are several meshes.
    """
    if len(meshes) == 1:
        return meshes[0]
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    triangles = [mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        triangles=np.concatenate(triangles).astype(np.int32),
    )


def _require_complete_stl(data: bytes, path: Path) -> None:
    """Refuse a truncated binary STL file.

    trimesh would misread it as an empty text file.
    """
    start = data[:84]
    count = int.from_bytes(start[80:84], "little")
    stored_count = (len(data) - 84) // 50
    if len(start) == 84 and not start.lstrip().startswith(b"solid") and count > stored_count:
        raise InputError(
            MESH_FILE_DAMAGED,
            "declares {count:,} triangles but holds {held:,}; it is damaged or cut short.",
            path,
            count=count,
            held=stored_count,
        )
