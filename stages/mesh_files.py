"""Read and write meshes in the formats people have: PLY, OBJ, OFF, STL, glTF.

PLY and OBJ are parsed here; the other formats by trimesh, under guard: what its readers raise becomes one
sentence, and files that promise more than they hold are refused before memory is reserved for it.
"""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from stages.cleaning.merge import merge_vertices
from stages.convert import as_mesh, to_trimesh, with_vertex_colors
from stages.errors import InputError, UsageError
from stages.formats.obj import read_obj, write_obj
from stages.formats.ply import read_ply, write_ply
from stages.mesh import Mesh
from stages.replacing import replacing
from stages.texture import Material, Texture

EXTENSIONS = (".ply", ".obj", ".off", ".stl", ".glb", ".gltf")
_WRITABLE = (".ply", ".obj", ".off", ".stl", ".glb")


def read_mesh(path: Path | str) -> Mesh:
    """Read a mesh file; its extension tells the format.

    All objects of a file become one mesh, placed as the file's scene places them. STL has no shared
    vertices and glTF none across texture seams: there, vertices of equal position and colour become one.

    Raises
    ------
    InputError
        If the file is missing, of an unknown format, damaged, or holds no triangles; one sentence with the
        name of the file.
    """
    path = Path(path)
    extension = path.suffix.lower()
    if extension not in EXTENSIONS:
        raise InputError(f"is of an unknown format {path.suffix!r}; known are {', '.join(EXTENSIONS)}.", path)
    if not path.is_file():
        raise InputError("does not exist." if not path.exists() else "is not a file.", path)
    if extension == ".ply":
        mesh = read_ply(path)
    elif extension == ".obj":
        mesh = read_obj(path)
    else:
        mesh = _read_with_trimesh(path, extension)
    if len(mesh.vertices) == 0:
        raise InputError("holds no vertices.", path)
    if len(mesh.triangles) == 0:
        raise InputError(f"holds {len(mesh.vertices):,} vertices but no triangles; a mesh is expected.", path)
    return mesh


def write_mesh(path: Path | str, mesh: Mesh) -> None:
    """Write a mesh; the extension tells the format. The file appears whole or not at all.

    PLY and OBJ hold everything a Mesh has, to the bit. GLB holds colours or one texture image, in single
    precision; several images become vertex colours. OFF and STL hold the shape alone.

    Raises
    ------
    UsageError
        If the extension is none of .ply, .obj, .off, .stl, .glb.
    StageError
        If the system refuses to write.
    """
    path = Path(path)
    extension = path.suffix.lower()
    if extension not in _WRITABLE:
        raise UsageError(f"{path}: meshes are written as {', '.join(_WRITABLE)}, not as {path.suffix!r}.")
    if extension == ".ply":
        write_ply(path, mesh)
    elif extension == ".obj":
        write_obj(path, mesh)
    else:
        holds_texture = mesh.texture is not None and len(mesh.texture.images) == 1
        data = to_trimesh(mesh if holds_texture else with_vertex_colors(mesh))
        with _quiet():
            written = data.export(file_type=extension[1:])
        with replacing(path) as part:
            part.write_bytes(written.encode() if isinstance(written, str) else written)


@contextmanager
def _quiet() -> Iterator[None]:
    # What NumPy and trimesh say of odd values on the way; what matters of them is validated afterwards.
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
    if extension in (".glb", ".gltf"):
        _require_honest_gltf(path, extension)
    if extension == ".stl":
        _require_whole_stl(path)
    import trimesh

    try:
        with _quiet():
            scene = trimesh.load_scene(path, process=False)
            parts = [_placed(scene, node) for node in scene.graph.nodes_geometry]
    except FileNotFoundError as error:
        raise InputError(f"refers to the file {error}, which is missing.", path) from error
    except MemoryError:
        raise InputError("promises more data than fits in memory; it is damaged.", path) from None
    except Exception as error:  # trimesh's readers raise whatever the first bad value leads to
        raise InputError(
            f"cannot be read as {extension[1:].upper()}: it is empty, damaged or cut short; "
            "get a whole copy of it.",
            path,
        ) from error
    meshes = [as_mesh(part, str(path)) for part in parts if isinstance(part, trimesh.Trimesh)]
    if extension == ".stl":
        return merge_vertices(_joined(meshes))
    if extension in (".glb", ".gltf"):
        meshes = [merge_vertices(mesh) for mesh in meshes]
    return _joined(meshes)


def _placed(scene: Any, node: str) -> Any:
    transform, name = scene.graph[node]
    part = scene.geometry[name].copy(include_cache=True)
    part.apply_transform(transform)
    return part


def _joined(meshes: list[Mesh]) -> Mesh:
    """Put meshes into one; an attribute some of them lack is kept where that loses nothing else."""
    if len(meshes) == 1:
        return meshes[0]
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    notes = [note for mesh in meshes for note in mesh.notes]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    triangles = [mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    colors = None
    if all(mesh.colors is not None for mesh in meshes):
        colors = np.concatenate([mesh.colors for mesh in meshes if mesh.colors is not None])
    elif any(mesh.colors is not None for mesh in meshes):
        notes.append("vertex colours are left out: some parts have none")
    normals = None
    if all(mesh.normals is not None for mesh in meshes):
        normals = np.concatenate([mesh.normals for mesh in meshes if mesh.normals is not None])
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        triangles=np.concatenate(triangles).astype(np.int32),
        colors=colors,
        normals=normals,
        texture=_joined_textures(meshes),
        notes=tuple(notes),
    )


def _joined_textures(meshes: list[Mesh]) -> Texture | None:
    if all(mesh.texture is None for mesh in meshes):
        return None
    uvs, material_ids = [], []
    materials: list[Material] = []
    for mesh in meshes:
        if mesh.texture is None:
            uvs.append(np.zeros((len(mesh.triangles), 3, 2)))
            material_ids.append(np.full(len(mesh.triangles), -1, np.int32))
            continue
        ids = mesh.texture.material_ids
        uvs.append(mesh.texture.uvs)
        material_ids.append(np.where(ids >= 0, ids + len(materials), -1).astype(np.int32))
        materials += mesh.texture.materials
    return Texture(np.concatenate(uvs), np.concatenate(material_ids), tuple(materials))


def _require_honest_gltf(path: Path, extension: str) -> None:
    """Refuse a glTF file with an accessor of more elements than its buffers have bytes.

    An accessor without a buffer view stands for that many zeros: a short file can ask for any amount.
    """
    try:
        data = path.read_bytes()
        if extension == ".glb":
            length = int.from_bytes(data[12:16], "little")
            data = data[20 : 20 + length]
        tree = json.loads(data)
        held = sum(int(buffer["byteLength"]) for buffer in tree.get("buffers", []))
        counts = [int(accessor["count"]) for accessor in tree.get("accessors", [])]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError("is not a sound glTF file: its description does not parse.", path) from error
    if extension == ".glb":
        held = min(held, path.stat().st_size)
    if counts and (min(counts) < 0 or max(counts) > held):
        raise InputError(
            f"has an accessor of {max(counts):,} elements for {held:,} bytes of data; it is damaged.", path
        )


def _require_whole_stl(path: Path) -> None:
    """Refuse a binary STL file that is cut short; trimesh would take it for text and find nothing in it."""
    with path.open("rb") as file:
        start = file.read(84)
    count = int.from_bytes(start[80:84], "little")
    held = (path.stat().st_size - 84) // 50
    if len(start) == 84 and not start.lstrip().startswith(b"solid") and count > held:
        raise InputError(
            f"promises {count:,} triangles but holds {held:,}; it is damaged or cut short.", path
        )
