"""Meshes that no memory holds at once: a PLY file in pieces, each a range of its vertices and triangles.

mesh.ply           as any program reads it
mesh.pieces.json   if it is that large: which vertices and triangles belong to which piece, and its box

A piece's triangles name vertices of other pieces where they join them. Whatever works piece by piece reads a
piece with those, as a mesh of its own, and the numbers its vertices have in all.
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
from scanloom.stages.files.documents import read_document
from scanloom.stages.files.opening import opened
from scanloom.stages.files.replacing import replacing
from scanloom.stages.surface.codes import MESH_FILE_DAMAGED
from scanloom.stages.surface.finite import require_finite
from scanloom.stages.surface.memory import give_back
from scanloom.stages.surface.mesh import NOT_WRITTEN, Mesh

Point = tuple[float, float, float]

_FACE = np.dtype([("length", "u1"), ("corners", "<i4", (3,))])
# Triangles; of more, a mesh is worked on in pieces. To simplify so many at once takes about 2 GB.
MOST_AT_ONCE = 5_000_000
# Vertices that are read at a time where few of all are wanted.
_READ_AT_ONCE = 1_000_000


def is_many(triangles: int) -> bool:
    """Whether a mesh of so many triangles is worked on in pieces."""
    return triangles > MOST_AT_ONCE


@dataclass(frozen=True)
class Extent:
    """Where a piece is.

    Attributes
    ----------
    vertices, triangles : (first, end) of its own, in the file.
    low, high : corners of the box whose surface it has, metres.
    """

    vertices: tuple[int, int]
    triangles: tuple[int, int]
    low: Point
    high: Point


@dataclass(frozen=True, eq=False)
class Part:
    """A piece, with the vertices of others that its triangles name.

    Attributes
    ----------
    mesh : its own vertices first.
    numbers : (n,) int64, of its vertices in all.
    own : how many are its own.
    """

    mesh: Mesh
    numbers: NDArray[np.int64]
    own: int


def table_of(path: Path) -> Path:
    """Return the file beside a PLY file that tells its pieces."""
    return path.with_suffix(".pieces.json")


class Pieces:
    """A PLY file in pieces, open for reading.

    Attributes
    ----------
    path : of the file.
    extents : of the pieces.
    spacing : metres; no edge of a triangle is longer than twice this.
    vertex_count, triangle_count : of all pieces.
    has_colors : whether vertices have colours.

    Raises
    ------
    InputError
        If the files are damaged, or do not fit each other.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        document = read_document(table_of(path))
        try:
            self.extents = tuple(
                Extent(*(tuple(one[name]) for name in ("vertices", "triangles", "low", "high")))
                for one in document["pieces"]
            )
            has_colors, self.spacing = bool(document["has_colors"]), float(document["spacing_m"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                MESH_FILE_DAMAGED,
                "this is no table of pieces: {error} is missing or wrong.",
                table_of(path),
                error=error,
            ) from error
        ends = [(one.vertices[1], one.triangles[1]) for one in self.extents] or [(0, 0)]
        self.vertex_count, self.triangle_count = ends[-1]
        header = _header(self.vertex_count, self.triangle_count, has_colors=has_colors)
        row = _row(has_colors=has_colors)
        starts = len(header), len(header) + self.vertex_count * row.itemsize
        size = starts[1] + self.triangle_count * _FACE.itemsize
        with opened(path) as file:
            is_it = file.read(len(header)) == header
        if not is_it or path.stat().st_size != size or not self._follow_each_other():
            raise InputError(
                MESH_FILE_DAMAGED, "the file is damaged, or not the one its table of pieces tells of.", path
            )
        self._row, self._starts = row, starts
        self.has_colors = has_colors

    def _rows(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return vertices and faces, mapped anew each time: what was read of a map counts as memory."""
        return (
            _mapped(self.path, self._row, self._starts[0], self.vertex_count),
            _mapped(self.path, _FACE, self._starts[1], self.triangle_count),
        )

    def _follow_each_other(self) -> bool:
        at = (0, 0)
        for one in self.extents:
            if (one.vertices[0], one.triangles[0]) != at:
                return False
            at = one.vertices[1], one.triangles[1]
            if at[0] < one.vertices[0] or at[1] < one.triangles[0]:
                return False
        return True

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.extents)

    def part(self, number: int) -> Part:
        """Read a piece.

        Raises
        ------
        InputError
            If a triangle names a vertex that is not there.
        """
        # What was done with the last one has left holes, which would grow from piece to piece.
        give_back()
        extent = self.extents[number]
        vertices, faces = self._rows()
        triangles = np.array(faces[slice(*extent.triangles)]["corners"], np.int64)
        if triangles.size and (triangles.min() < 0 or triangles.max() >= self.vertex_count):
            raise InputError(
                MESH_FILE_DAMAGED,
                "the file is damaged: a triangle names a vertex that is not there.",
                self.path,
            )
        first, end = extent.vertices
        numbers, local = counted_from(first, end, triangles)
        rows = np.concatenate([vertices[first:end], vertices[numbers[end - first :]]])
        places = np.stack([rows[axis] for axis in "xyz"], axis=1)
        colors = np.stack([rows[c] for c in _COLORS], axis=1) if self.has_colors else None
        return Part(Mesh(places, local, colors), numbers, end - first)

    def places(self, step: int) -> NDArray[np.float64]:
        """Read every `step`-th vertex (k, 3), metres."""
        # Each time from a map that forgets what was read before: of many vertices there is no room for all.
        at_once = step * max(_READ_AT_ONCE // step, 1)
        found = [np.zeros((0, 3))]
        for start in range(0, self.vertex_count, at_once):
            rows = self._rows()[0][start : start + at_once : step]
            found.append(np.stack([rows[axis] for axis in "xyz"], axis=1))
        return np.concatenate(found)


def counted_from(
    first: int, end: int, triangles: NDArray[np.integer[Any]]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return the numbers of a piece's vertices, its own first, and its triangles by places among these.

    Parameters
    ----------
    first, end : of its own vertices.
    triangles : (m, 3), by numbers in all.
    """
    is_foreign = (triangles < first) | (triangles >= end)
    foreign = np.unique(triangles[is_foreign])
    local = (triangles - first).astype(np.int32)
    local[is_foreign] = end - first + np.searchsorted(foreign, triangles[is_foreign])
    return np.concatenate([np.arange(first, end), foreign.astype(np.int64)]), local


@dataclass(frozen=True, eq=False)
class Written:
    """A piece to be written: its own vertices, and triangles by numbers that count through all pieces.

    `values` (n, v) are what is known of the vertices beside their colours.
    """

    vertices: NDArray[np.float64]
    colors: NDArray[np.uint8] | None
    triangles: NDArray[np.integer[Any]]
    values: NDArray[np.float32] | None = None


def write_pieces(
    path: Path, sizes: Sequence[Extent], pieces: Iterable[Written], *, has_colors: bool, spacing: float
) -> None:
    """Write a PLY file, and the table of its pieces if it has more than MOST_AT_ONCE triangles.

    Parameters
    ----------
    sizes : of the pieces, which follow each other.
    pieces : as many, read once.
    spacing : metres; no edge of a triangle is longer than twice this.

    Raises
    ------
    StageError
        If the system refuses to write.
    """
    vertex_count, triangle_count = (sizes[-1].vertices[1], sizes[-1].triangles[1]) if sizes else (0, 0)
    write_by_pieces(path, vertex_count, triangle_count, pieces, has_colors=has_colors)
    if not is_many(triangle_count):
        return
    document = {"has_colors": has_colors, "spacing_m": spacing, "pieces": [asdict(one) for one in sizes]}
    with replacing(table_of(path)) as part:
        part.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")


def write_by_pieces(
    path: Path,
    vertex_count: int,
    triangle_count: int,
    pieces: Iterable[Written],
    *,
    has_colors: bool,
    values: Sequence[str] = (),
) -> None:
    """Write a PLY file without a table: as it comes, one piece after the other, and read as any PLY file is.

    Parameters
    ----------
    vertex_count, triangle_count : of all pieces.
    pieces : read once.
    values : names of those that vertices have.

    Raises
    ------
    StageError
        If the system refuses to write.
    """
    header = _header(vertex_count, triangle_count, has_colors=has_colors, values=values)
    row = _row(has_colors=has_colors, values=values)
    with replacing(path) as part, part.open("wb") as file:
        file.write(header)
        ends = [len(header), len(header) + vertex_count * row.itemsize]
        for piece in pieces:
            require_finite([("vertex", piece.vertices)], path, NOT_WRITTEN)
            rows = np.empty(len(piece.vertices), row)
            for axis, name in enumerate("xyz"):
                rows[name] = piece.vertices[:, axis]
            if has_colors:
                for channel, name in enumerate(_COLORS):
                    rows[name] = 0 if piece.colors is None else piece.colors[:, channel]
            for column, name in enumerate(values):
                rows[name] = 0 if piece.values is None else piece.values[:, column]
            corners = np.empty(len(piece.triangles), _FACE)
            corners["length"] = 3
            corners["corners"] = piece.triangles
            for which, table in enumerate((rows, corners)):
                file.seek(ends[which])
                file.write(table.data)
                ends[which] += table.nbytes


_COLORS = ("red", "green", "blue")


def _row(*, has_colors: bool, values: Sequence[str] = ()) -> np.dtype[Any]:
    colors = ((name, "u1") for name in _COLORS if has_colors)
    return np.dtype([*((axis, "<f8") for axis in "xyz"), *colors, *((name, "<f4") for name in values)])


def _header(vertices: int, triangles: int, *, has_colors: bool, values: Sequence[str] = ()) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"property uchar {color}" for color in _COLORS if has_colors]
    lines += [f"property float {name}" for name in values]
    lines += [f"element face {triangles}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(lines).encode()


def _mapped(path: Path, row: np.dtype[Any], start: int, count: int) -> NDArray[Any]:
    # Nothing can be mapped of no bytes.
    return np.memmap(path, row, "r", start, (count,)) if count else np.zeros(0, row)
