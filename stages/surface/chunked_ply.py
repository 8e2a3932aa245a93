"""Chunked PLY files for meshes that exceed memory.

A chunk is a range of consecutive vertices and triangles.

mesh.ply           standard PLY, readable by any program
mesh.pieces.json   only for large meshes: vertex range, triangle range and bounding box of each chunk, and the
                   names of further vertex properties

Triangles of a chunk can reference vertices of other chunks. A chunk is read as a mesh that includes these
vertices, together with the index of each vertex in the whole mesh.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.documents import read_document
from scanloom.stages.files.input_files import open_input
from scanloom.stages.surface.codes import MESH_FILE_DAMAGED
from scanloom.stages.surface.finite_check import require_finite
from scanloom.stages.surface.memory_release import release_free_memory
from scanloom.stages.surface.mesh import WRITING_REMEDY, Mesh

PointTuple = tuple[float, float, float]

_FACE_DTYPE = np.dtype([("length", "u1"), ("corners", "<i4", (3,))])
# Triangles up to which a mesh is processed in memory; larger meshes are processed in chunks. Simplifying this
# number at once takes about 2 GB.
MAX_IN_MEMORY_TRIANGLES = 5_000_000
# Vertices read at a time when only a subsample is needed.
_VERTICES_PER_READ = 1_000_000


def exceeds_chunk_limit(triangles: int) -> bool:
    """Return True if a mesh of `triangles` triangles must be processed in chunks."""
    return triangles > MAX_IN_MEMORY_TRIANGLES


@dataclass(frozen=True)
class ChunkExtent:
    """Ranges and bounding box of a chunk.

    Attributes
    ----------
    vertices, triangles : (first, end) of the chunk's own rows in the file.
    low, high : corners of the region whose surface the chunk holds, metres.
    """

    vertices: tuple[int, int]
    triangles: tuple[int, int]
    low: PointTuple
    high: PointTuple


@dataclass(frozen=True, eq=False)
class MeshChunk:
    """A chunk as a mesh, including vertices of other chunks that its triangles reference.

    Attributes
    ----------
    mesh : mesh whose vertices are the chunk's own ones, then the foreign ones.
    global_indices : (n,) int64, index of each vertex in the whole mesh.
    own_count : number of own vertices.
    """

    mesh: Mesh
    global_indices: NDArray[np.int64]
    own_count: int


def make_table_path(path: Path) -> Path:
    """Return the path of the chunk table that belongs to a PLY file."""
    return path.with_suffix(".pieces.json")


class ChunkedPly:
    """A PLY file with a chunk table, open for reading.

    Attributes
    ----------
    path : the PLY file.
    extents : ranges and bounding box of each chunk.
    spacing : metres; no triangle edge is longer than twice this.
    vertex_count, triangle_count : totals over all chunks.
    has_colors : True if vertices have colours.

    Raises
    ------
    InputError
        If a file is damaged, or the table does not match the PLY file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        document = read_document(make_table_path(path))
        try:
            self.extents = tuple(
                ChunkExtent(*(tuple(one[name]) for name in ("vertices", "triangles", "low", "high")))
                for one in document["pieces"]
            )
            has_colors, self.spacing = bool(document["has_colors"]), float(document["spacing_m"])
            values = tuple(str(name) for name in document.get("values", ()))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                MESH_FILE_DAMAGED,
                "this is not a valid chunk table: {error} is missing or wrong.",
                make_table_path(path),
                error=error,
            ) from error
        ends = [(one.vertices[1], one.triangles[1]) for one in self.extents] or [(0, 0)]
        self.vertex_count, self.triangle_count = ends[-1]
        header = _make_header(self.vertex_count, self.triangle_count, has_colors=has_colors, values=values)
        row = _make_row_dtype(has_colors=has_colors, values=values)
        starts = len(header), len(header) + self.vertex_count * row.itemsize
        size = starts[1] + self.triangle_count * _FACE_DTYPE.itemsize
        with open_input(path) as file:
            has_header = file.read(len(header)) == header
        if not has_header or path.stat().st_size != size or not self._has_consecutive_ranges():
            raise InputError(
                MESH_FILE_DAMAGED, "the file is damaged, or does not match its chunk table.", path
            )
        self._row_dtype, self._table_offsets = row, starts
        self.has_colors = has_colors

    def _map_tables(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Map vertices and faces into memory.

        Each call makes a new map, because pages read from a map count as memory.
        """
        return (
            _map_rows(self.path, self._row_dtype, self._table_offsets[0], self.vertex_count),
            _map_rows(self.path, _FACE_DTYPE, self._table_offsets[1], self.triangle_count),
        )

    def _has_consecutive_ranges(self) -> bool:
        at = (0, 0)
        for one in self.extents:
            if (one.vertices[0], one.triangles[0]) != at:
                return False
            at = one.vertices[1], one.triangles[1]
            if at[0] < one.vertices[0] or at[1] < one.triangles[0]:
                return False
        return True

    def __len__(self) -> int:
        """Return the number of chunks."""
        return len(self.extents)

    def read_chunk(self, index: int) -> MeshChunk:
        """Read a chunk.

        Raises
        ------
        InputError
            If a triangle references a vertex that does not exist.
        """
        # Processing the previous chunk fragmented the heap; without this, memory grows from chunk to chunk.
        release_free_memory()
        extent = self.extents[index]
        vertices, faces = self._map_tables()
        triangles = np.array(faces[slice(*extent.triangles)]["corners"], np.int64)
        self._require_known_vertices(triangles)
        first, end = extent.vertices
        numbers, local = localize_indices(first, end, triangles)
        rows = np.concatenate([vertices[first:end], vertices[numbers[end - first :]]])
        places = np.stack([rows[axis] for axis in "xyz"], axis=1)
        colors = np.stack([rows[c] for c in _COLORS], axis=1) if self.has_colors else None
        return MeshChunk(Mesh(places, local, colors), numbers, end - first)

    def read_mesh(self) -> Mesh:
        """Read the whole mesh, for work that needs it in memory.

        Raises
        ------
        InputError
            If a triangle references a vertex that does not exist.
        """
        vertices, faces = self._map_tables()
        triangles = np.array(faces["corners"], np.int32)
        self._require_known_vertices(triangles)
        colors = np.stack([vertices[c] for c in _COLORS], axis=1) if self.has_colors else None
        return Mesh(np.stack([vertices[axis] for axis in "xyz"], axis=1), triangles, colors)

    def _require_known_vertices(self, triangles: NDArray[np.integer[Any]]) -> None:
        if triangles.size and (triangles.min() < 0 or triangles.max() >= self.vertex_count):
            raise InputError(
                MESH_FILE_DAMAGED,
                "the file is damaged: a triangle references a vertex that does not exist.",
                self.path,
            )

    def sample_vertices(self, step: int) -> NDArray[np.float64]:
        """Read every `step`-th vertex as positions (k, 3), metres."""
        # A new map per block releases the pages read before; all vertices together can exceed memory.
        block_size = step * max(_VERTICES_PER_READ // step, 1)
        found = [np.zeros((0, 3))]
        for start in range(0, self.vertex_count, block_size):
            rows = self._map_tables()[0][start : start + block_size : step]
            found.append(np.stack([rows[axis] for axis in "xyz"], axis=1))
        return np.concatenate(found)


def localize_indices(
    first: int, end: int, triangles: NDArray[np.integer[Any]]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Convert triangles of a chunk from global to local vertex indices.

    Parameters
    ----------
    first, end : range of the chunk's own vertices.
    triangles : (m, 3) global vertex indices.

    Returns
    -------
    The global index (n,) of each local vertex, own ones first, and the triangles (m, 3) in local indices.
    """
    is_foreign = (triangles < first) | (triangles >= end)
    foreign = np.unique(triangles[is_foreign])
    local = (triangles - first).astype(np.int32)
    local[is_foreign] = end - first + np.searchsorted(foreign, triangles[is_foreign])
    return np.concatenate([np.arange(first, end), foreign.astype(np.int64)]), local


@dataclass(frozen=True, eq=False)
class WrittenChunk:
    """A chunk to write: its own vertices, and triangles with global vertex indices.

    `values` (n, v) are further vertex properties.
    """

    vertices: NDArray[np.float64]
    colors: NDArray[np.uint8] | None
    triangles: NDArray[np.integer[Any]]
    values: NDArray[np.float32] | None = None


def write_chunked_ply(
    path: Path,
    extents: Sequence[ChunkExtent],
    chunks: Iterable[WrittenChunk],
    *,
    has_colors: bool,
    spacing: float,
    values: Sequence[str] = (),
) -> None:
    """Write a PLY file, and a chunk table if it is large.

    The table is written for more than MAX_IN_MEMORY_TRIANGLES triangles.

    Parameters
    ----------
    path : output file.
    extents : ranges of the consecutive chunks.
    chunks : one chunk per entry of `extents`, consumed once.
    has_colors : True if vertices have colours.
    spacing : metres; no triangle edge is longer than twice this.
    values : names of the further vertex properties.

    Raises
    ------
    StageError
        If a file cannot be written.
    """
    vertex_count, triangle_count = (extents[-1].vertices[1], extents[-1].triangles[1]) if extents else (0, 0)
    write_ply_in_chunks(path, vertex_count, triangle_count, chunks, has_colors=has_colors, values=values)
    if not exceeds_chunk_limit(triangle_count):
        return
    document = {
        "has_colors": has_colors,
        **({"values": list(values)} if values else {}),
        "spacing_m": spacing,
        "pieces": [asdict(one) for one in extents],
    }
    with write_file_atomically(make_table_path(path)) as part:
        part.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")


def write_ply_in_chunks(
    path: Path,
    vertex_count: int,
    triangle_count: int,
    chunks: Iterable[WrittenChunk],
    *,
    has_colors: bool,
    values: Sequence[str] = (),
) -> None:
    """Write a PLY file chunk by chunk, without a chunk table.

    Parameters
    ----------
    path : output file.
    vertex_count, triangle_count : totals over all chunks.
    chunks : chunks in order, consumed once.
    has_colors : True if vertices have colours.
    values : names of the further vertex properties.

    Raises
    ------
    StageError
        If the file cannot be written.
    """
    header = _make_header(vertex_count, triangle_count, has_colors=has_colors, values=values)
    row = _make_row_dtype(has_colors=has_colors, values=values)
    with write_file_atomically(path) as part, part.open("wb") as file:
        file.write(header)
        ends = [len(header), len(header) + vertex_count * row.itemsize]
        for piece in chunks:
            require_finite([("vertex", piece.vertices)], path, WRITING_REMEDY)
            rows = np.empty(len(piece.vertices), row)
            for axis, name in enumerate("xyz"):
                rows[name] = piece.vertices[:, axis]
            if has_colors:
                for channel, name in enumerate(_COLORS):
                    rows[name] = 0 if piece.colors is None else piece.colors[:, channel]
            for column, name in enumerate(values):
                rows[name] = 0 if piece.values is None else piece.values[:, column]
            corners = np.empty(len(piece.triangles), _FACE_DTYPE)
            corners["length"] = 3
            corners["corners"] = piece.triangles
            for which, table in enumerate((rows, corners)):
                file.seek(ends[which])
                file.write(table.data)
                ends[which] += table.nbytes


_COLORS = ("red", "green", "blue")


def _make_row_dtype(*, has_colors: bool, values: Sequence[str] = ()) -> np.dtype[Any]:
    colors = ((name, "u1") for name in _COLORS if has_colors)
    return np.dtype([*((axis, "<f8") for axis in "xyz"), *colors, *((name, "<f4") for name in values)])


def _make_header(vertices: int, triangles: int, *, has_colors: bool, values: Sequence[str] = ()) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"property uchar {color}" for color in _COLORS if has_colors]
    lines += [f"property float {name}" for name in values]
    lines += [f"element face {triangles}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(lines).encode()


def _map_rows(path: Path, row: np.dtype[Any], start: int, count: int) -> NDArray[Any]:
    # An empty range cannot be memory-mapped.
    return np.memmap(path, row, "r", start, (count,)) if count else np.zeros(0, row)
