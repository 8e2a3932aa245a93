"""Reader and writer of `.slod` files: a hierarchy, coarsest level first.

All numbers are little-endian. The file starts with a header (lengths and a checksum) and the tree as JSON.
Then each node follows, from the root: new vertices, their origins, splits, triangles, and a checksum. The
root's block begins with the vertices that exist before any split. The last block is the textured source mesh
as a GLB file with its checksum, if there is one. A truncated file has fewer nodes, and is still a mesh.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.input_files import describe_os_error, read_input_bytes
from scanloom.stages.lod.codes import LEVELS_CUT_OFF, LEVELS_FILE_DAMAGED
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.surface.finite_check import require_finite
from scanloom.stages.surface.mesh import WRITING_REMEDY

_MAGIC = b"SLOD"
# Version 2 adds the dropped components; without them, it equals version 1.
_FORMAT_VERSION = 2
# Magic, version, size of the tree in bytes, and checksum of the tree.
_HEADER = struct.Struct("<4sIQI")
_CHECKSUM = struct.Struct("<I")
_NODE_COLUMNS = ("parent", "level", "coarse", "splits", "vertices", "triangles", "shape_bound", "color_bound")
# Maximum count of elements: larger values come from damaged or foreign files.
_MAX_COUNT = 2**31 - 1
# Tolerance of the length of a unit direction.
_UNIT_TOLERANCE = 1e-9


def write_slod(path: Path | str, hierarchy: Hierarchy) -> None:
    """Write a hierarchy to a `.slod` file, atomically.

    Coordinates are stored in single precision if that is lossless, else in double precision.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    h = hierarchy
    require_finite([("vertex", h.vertices)], path, WRITING_REMEDY)
    single = bool((h.vertices == h.vertices.astype(np.float32)).all())
    tree = {
        "coordinates": "float32" if single else "float64",
        "colors": h.colors is not None,
        "roots": h.roots,
        "base_shape_bound": h.base_shape_bound,
        "base_color_bound": h.base_color_bound,
        "input_triangles": h.input_triangles,
        "one_sided": h.is_one_sided,
        "dropped_islands": h.dropped_islands,
        "dropped_triangles": h.dropped_triangles,
        "diagnostics": [diagnostic.to_dict() for diagnostic in h.diagnostics],
        # Optional keys; older readers ignore them.
        **({} if h.up is None else {"up": list(h.up)}),
        **({} if h.model_glb is None else {"model_bytes": len(h.model_glb)}),
        "nodes": {
            "parent": h.parent.tolist(),
            "level": h.level.tolist(),
            "coarse": h.coarse.tolist(),
            "splits": h.splits.tolist(),
            "vertices": np.diff(h.vertices_after[h.first_split]).tolist(),
            "triangles": h.full.tolist(),
            "shape_bound": h.shape_bound.tolist(),
            "color_bound": h.color_bound.tolist(),
        },
    }
    text = json.dumps(tree, separators=(",", ":")).encode()
    parts = [_HEADER.pack(_MAGIC, _FORMAT_VERSION, len(text), zlib.crc32(text)), text]
    for node in range(h.nodes):
        block = _encode_node(h, node, np.dtype("<f4" if single else "<f8"))
        parts += [block, _CHECKSUM.pack(zlib.crc32(block))]
    if h.model_glb is not None:
        parts += [h.model_glb, _CHECKSUM.pack(zlib.crc32(h.model_glb))]
    with write_file_atomically(Path(path)) as draft:
        draft.write_bytes(b"".join(parts))


def _encode_node(h: Hierarchy, node: int, coordinates: np.dtype[Any]) -> bytes:
    splits = slice(*h.first_split[node : node + 2])
    first, last = h.vertices_after[h.first_split[node : node + 2]]
    own = slice(0 if node == 0 else first, last)
    triangles = h.triangles[slice(*h.first_triangle[node : node + 2])]
    parts = [h.vertices[own].astype(coordinates)]
    if h.colors is not None:
        parts.append(h.colors[own])
    parts += [h.origin[first - h.roots : last - h.roots].astype("<u4"), h.made[splits], h.born[splits]]
    parts.append(triangles.astype("<u4"))
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)


def read_slod(path: Path | str) -> Hierarchy:
    """Read a hierarchy from a `.slod` file.

    Of a truncated or damaged file, the nodes before the damage are read, with a warning.
    `Hierarchy.diagnostics` also contains the stored diagnostics of the mesh the levels were built from. Only
    diagnostics of the file itself are emitted.

    Raises
    ------
    InputError
        If the file cannot be read, is not a `.slod` file, has another version, or its root is incomplete.
    """
    path = Path(path)
    try:
        data = read_input_bytes(path)
    except OSError as error:
        raise InputError(FILE_UNREADABLE, describe_os_error(error), path) from None
    if len(data) < _HEADER.size or data[:4] != _MAGIC:
        raise InputError(LEVELS_FILE_DAMAGED, "this is not a .slod file.", where=path)
    _, version, size, checksum = _HEADER.unpack_from(data)
    if version != _FORMAT_VERSION:
        raise InputError(
            LEVELS_FILE_DAMAGED,
            "this .slod file has version {version}; this scanloom reads version {format_version}.",
            where=path,
            version=version,
            format_version=_FORMAT_VERSION,
        )
    text = data[_HEADER.size : _HEADER.size + size]
    if len(text) < size or zlib.crc32(text) != checksum:
        raise InputError(
            LEVELS_FILE_DAMAGED, "the file is damaged or truncated before its first level.", where=path
        )
    try:
        with collecting() as diagnostics:
            hierarchy = _read_nodes(data, _HEADER.size + size, json.loads(text), path)
        return replace(hierarchy, diagnostics=(*hierarchy.diagnostics, *diagnostics))
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(
            LEVELS_FILE_DAMAGED,
            "the .slod file is damaged: {detail}.",
            where=path,
            detail=error or "its content is inconsistent",
        ) from None


def _read_nodes(data: bytes, at: int, tree: dict[str, Any], path: Path) -> Hierarchy:
    columns = {name: tree["nodes"][name] for name in _NODE_COLUMNS}
    count = len(columns["parent"])
    if count == 0 or any(len(column) != count for column in columns.values()):
        raise ValueError("the tree is incomplete")
    roots = _parse_count(tree["roots"])
    coordinates: np.dtype[Any] = np.dtype({"float32": "<f4", "float64": "<f8"}[tree["coordinates"]])
    sizes = {
        name: [_parse_count(x) for x in columns[name]]
        for name in ("coarse", "splits", "vertices", "triangles")
    }
    blocks: list[list[NDArray[Any]]] = []
    for node in range(count):
        own = sizes["vertices"][node]
        vertex_count = own + (roots if node == 0 else 0)
        splits, triangles = sizes["splits"][node], sizes["triangles"][node]
        layout: list[tuple[np.dtype[Any], int]] = [
            (coordinates, 3 * vertex_count),
            (np.dtype("u1"), 3 * vertex_count if tree["colors"] else 0),
        ]
        layout += [(np.dtype("<u4"), own), (np.dtype("u1"), splits), (np.dtype("u1"), splits)]
        layout.append((np.dtype("<u4"), 3 * triangles))
        size = sum(kind.itemsize * number for kind, number in layout)
        block = _read_block(data, at, size)
        if block is None:
            break
        at += size + _CHECKSUM.size
        arrays, offset = [], 0
        for kind, number in layout:
            arrays.append(np.frombuffer(block, kind, number, offset))
            offset += kind.itemsize * number
        blocks.append(arrays)
    # Children replace their parent together, so drop an incomplete group of siblings; siblings are
    # consecutive.
    parents = columns["parent"]
    while 0 < len(blocks) < count and parents[len(blocks)] == parents[len(blocks) - 1]:
        blocks.pop()
    if not blocks:
        raise ValueError("the root is incomplete")
    hierarchy = _assemble_hierarchy(tree, columns, sizes, roots, blocks)
    _require_consistent(hierarchy)
    if len(blocks) < count:
        emit(
            LEVELS_CUT_OFF.warning(
                "the file ends after {there:,} of {count:,} nodes; finer levels are missing.",
                path,
                there=len(blocks),
                count=count,
            )
        )
        return hierarchy
    if "model_bytes" not in tree:
        return hierarchy
    model = _read_block(data, at, _parse_count(tree["model_bytes"]))
    if model is None:
        emit(
            LEVELS_CUT_OFF.warning(
                "the textured mesh at the end of the file is damaged or truncated; vertex colours are used.",
                path,
            )
        )
        return hierarchy
    return replace(hierarchy, model_glb=model)


def _read_block(data: bytes, at: int, size: int) -> bytes | None:
    """Return the block of `size` bytes, or None if it is truncated or fails its checksum."""
    block = data[at : at + size]
    if len(data) < at + size + _CHECKSUM.size:
        return None
    return block if _CHECKSUM.unpack_from(data, at + size)[0] == zlib.crc32(block) else None


def _assemble_hierarchy(
    tree: dict[str, Any],
    columns: dict[str, list[Any]],
    sizes: dict[str, list[int]],
    roots: int,
    blocks: list[list[NDArray[Any]]],
) -> Hierarchy:
    node_count = len(blocks)

    def concatenate_blocks(i: int) -> NDArray[Any]:
        return np.concatenate([part[i] for part in blocks])

    def compute_offsets(name: str) -> NDArray[np.int64]:
        return np.concatenate([[0], np.cumsum(sizes[name][:node_count], dtype=np.int64)])

    def get_column(name: str, kind: Any) -> NDArray[Any]:
        return np.asarray(columns[name][:node_count], kind)

    return Hierarchy(
        vertices=concatenate_blocks(0).reshape(-1, 3).astype(np.float64),
        colors=concatenate_blocks(1).reshape(-1, 3) if tree["colors"] else None,
        roots=roots,
        origin=concatenate_blocks(2).astype(np.uint32),
        made=concatenate_blocks(3),
        born=concatenate_blocks(4),
        triangles=concatenate_blocks(5).reshape(-1, 3).astype(np.uint32),
        parent=get_column("parent", np.int32),
        level=get_column("level", np.int32),
        coarse=get_column("coarse", np.int32),
        first_split=compute_offsets("splits"),
        first_triangle=compute_offsets("triangles"),
        shape_bound=get_column("shape_bound", np.float64),
        color_bound=get_column("color_bound", np.float64),
        base_shape_bound=float(tree["base_shape_bound"]),
        base_color_bound=float(tree["base_color_bound"]),
        input_triangles=_parse_count(tree["input_triangles"]),
        diagnostics=tuple(map(_parse_diagnostic, tree["diagnostics"])),
        dropped_islands=_parse_count(tree["dropped_islands"]),
        dropped_triangles=_parse_count(tree["dropped_triangles"]),
        up=_parse_direction(tree["up"]) if "up" in tree else None,
    )


def _parse_diagnostic(value: object) -> Diagnostic:
    if not isinstance(value, dict) or not isinstance(value.get("values", {}), dict):
        raise ValueError(f"{value!r} is not a diagnostic")
    diagnostic = Diagnostic.from_dict(value)
    texts = (diagnostic.code, diagnostic.message, diagnostic.remedy or "")
    if not all(isinstance(text, str) for text in texts):
        raise ValueError(f"{value!r} is not a diagnostic")
    return diagnostic


def _parse_direction(value: object) -> tuple[float, float, float]:
    if not isinstance(value, list) or [type(x) for x in value] != [float] * 3:
        raise ValueError(f"{value!r} is not a direction")
    x, y, z = value
    if not abs(x * x + y * y + z * z - 1) < _UNIT_TOLERANCE:
        raise ValueError(f"{value!r} is not a direction of length 1")
    return x, y, z


def _parse_count(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= _MAX_COUNT:
        raise ValueError(f"{value!r} is not a valid count")
    return value


def _require_consistent(h: Hierarchy) -> None:
    """Raise ValueError if indices are out of range, cyclic or inconsistent."""
    numbers = np.arange(h.nodes)
    if h.parent[0] != -1 or (h.parent[1:] < 0).any() or (h.parent[1:] >= numbers[1:]).any():
        raise ValueError("invalid tree: a node precedes its parent")
    if not np.isfinite(h.vertices).all():
        raise ValueError("a coordinate is not finite")
    if not (np.isfinite(h.shape_bound).all() and (h.shape_bound >= 0).all() and (h.color_bound >= 0).all()):
        raise ValueError("invalid bound: negative or not finite")
    if (h.made < 1).any() or (h.made > 2).any() or (h.born > 2).any():
        raise ValueError("invalid split: it must add 1 or 2 vertices and at most 2 triangles")
    if (np.diff(h.vertices_after[h.first_split]) != _count_node_vertices(h)).any():
        raise ValueError("the number of vertices contradicts the splits")
    own = np.arange(h.roots, len(h.vertices))
    if (h.origin >= own).any():
        raise ValueError("invalid origin: a vertex merges into a later one")
    below = np.repeat(h.vertices_after[h.first_split[1:]], h.full)
    if (h.triangles >= below[:, None]).any():
        raise ValueError("a triangle refers to a missing vertex")
    born = np.diff(h.born_before[h.first_split])
    if (h.coarse + born != h.full).any():
        raise ValueError("the number of triangles contradicts the splits")


def _count_node_vertices(h: Hierarchy) -> NDArray[np.int64]:
    return np.asarray(np.add.reduceat(np.append(h.made, 0), h.first_split[:-1]) * (h.splits > 0))
