"""A mesh in pieces, of which some triangles at a time are worked on, as of the whole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.pieces import Part, Pieces
from scanloom.stages.surface.raycasting import Floats, bounding_box
from scanloom.stages.surface.runs import Runs
from scanloom.stages.surface.topology import areas
from scanloom.stages.surface.vertex_normals import normal_sums, unit, vertex_normals

# Vertices that are kept of all of them, about: no point is farther from the surface than from one of these.
_LANDMARKS = 200_000
# Of the nearest of these, so much farther off may be the one that is taken.
_ROUGHLY = 0.1
# Triangles that are worked on at a time: to search them takes about a kilobyte for each.
AT_ONCE = 250_000
# Of so many, all are worked on at once.
_FEW = 1_000_000


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece, or of one with many triangles some of them.

    Attributes
    ----------
    mesh : its triangles.
    box : (2, 3) lowest and highest corner around them, metres.
    normals : (n, 3) float32 unit normals of the vertices, those of the whole; None if not asked for.
    numbers : (n,) int64, of its vertices in all.
    """

    mesh: Mesh
    box: Floats
    normals: NDArray[np.float32] | None
    numbers: NDArray[np.int64]


def piecewise(mesh: Mesh) -> Mesh | Piecewise:
    """Return a mesh, or what works on it piece by piece where that takes far less memory."""
    return mesh if len(mesh.triangles) <= _FEW else Piecewise(Runs(mesh))


class Piecewise:
    """A mesh in pieces, looked over.

    Beside a piece, memory holds what is known of vertices that several pieces name.

    Parameters
    ----------
    pieces : of a file, or the runs of a mesh.

    Attributes
    ----------
    has_colors : whether vertices have colours.
    triangle_count, vertex_count : of all pieces.
    box : (2, 3) lowest and highest corner around all triangles, metres.
    area_ends : (p,) area of the pieces up to and with each, m²: sums over all their triangles in order.

    Raises
    ------
    InputError
        If the files are damaged, or do not fit each other.
    """

    def __init__(self, pieces: Pieces | Runs) -> None:
        self._pieces = pieces
        self.has_colors = self._pieces.has_colors
        self.triangle_count = self._pieces.triangle_count
        self.vertex_count = self._pieces.vertex_count
        count = len(self._pieces)
        self.box = np.stack([np.full(3, np.inf), np.full(3, -np.inf)])
        self.area_ends = np.zeros(count)
        step = 1 + self._pieces.triangle_count // _LANDMARKS
        landmarks = [np.zeros((0, 3))]
        for number in range(count):
            mesh = self.mesh(number)
            self.area_ends[number] = self.areas_up_to(number, mesh)[-1]
            landmarks.append(mesh.vertices[mesh.triangles[::step, 0]])
            if len(mesh.triangles):
                low, high = bounding_box(mesh)
                self.box = np.stack([np.minimum(self.box[0], low), np.maximum(self.box[1], high)])
        self._landmarks = np.concatenate(landmarks)

    def __len__(self) -> int:
        """Return how many pieces there are."""
        return len(self._pieces)

    @property
    def area(self) -> float:
        """Of all triangles, m²."""
        return float(self.area_ends[-1])

    def areas_up_to(self, number: int, mesh: Mesh) -> Floats:
        """Return what `area_ends` is after each triangle of a piece (m,), after the one before it first."""
        before = self.area_ends[number - 1] if number else 0.0
        some = (mesh.triangles[first : first + AT_ONCE] for first in range(0, len(mesh.triangles), AT_ONCE))
        return np.cumsum(np.concatenate([[before], *(areas(mesh.vertices, rows) for rows in some)]))

    def mesh(self, number: int) -> Mesh:
        """Read the triangles of a piece."""
        return self._pieces.part(number).mesh

    def pieces(self, *, facing: bool = False) -> Iterator[Piece]:
        """Read one after the other, of each no more triangles at a time than much can be done with.

        Parameters
        ----------
        facing : whether normals are wanted.
        """
        for number in range(len(self._pieces)):
            part = self._pieces.part(number)
            normals = self.normals(part) if facing else None
            # What follows on each other in a piece is near each other.
            for first in range(0, len(part.mesh.triangles), AT_ONCE):
                yield _some(part, normals, slice(first, first + AT_ONCE))

    def parts(self) -> Iterator[Part]:
        """Read one piece after the other, each with its own vertices."""
        return (self._pieces.part(number) for number in range(len(self._pieces)))

    def some_vertices(self, wanted: int) -> Floats:
        """Return about so many vertices (k, 3), at equal steps through all."""
        return self._pieces.places(1 + self._pieces.vertex_count // wanted)

    def at_most(self, points: Floats) -> Floats:
        """Return distances (k,) that points are no farther from the surface than, metres."""
        # Any of them will do, and one that is nearly the nearest is found much sooner where all are far off.
        return np.asarray(self._tree.query(points, eps=_ROUGHLY, workers=-1)[0], np.float64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self._landmarks, balanced_tree=False)

    def normals(self, part: Part) -> NDArray[np.float32]:
        """Return the unit normals (n, 3) of the vertices of a piece, with what others have there."""
        sums = normal_sums(part.mesh)
        numbers, of_all = self._shared
        rows = rows_of(numbers, part.numbers)
        sums[rows >= 0] = of_all[rows[rows >= 0]]
        return unit(sums).astype(np.float32)

    @cached_property
    def _shared(self) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """The vertices that several pieces name, (s,) numbers in all and (s, 3) sums of normals there.

        They are many where a wall or a floor runs along faces of pieces.
        """
        named = [np.zeros(0, np.int32)]
        for number in range(len(self._pieces)):
            part = self._pieces.part(number)
            named.append(part.numbers[part.own :].astype(np.int32))
        numbers = np.unique(np.concatenate(named))
        sums = np.zeros((len(numbers), 3), np.float32)
        for number in range(len(self._pieces)):
            part = self._pieces.part(number)
            rows = rows_of(numbers, part.numbers)
            sums[rows[rows >= 0]] += normal_sums(part.mesh)[rows >= 0].astype(np.float32)
        return numbers, sums


def rows_of(known: NDArray[np.integer[Any]], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where numbers (n,) are among known ones (k,), which ascend; −1 where they are not."""
    if not len(known):
        return np.full(len(wanted), -1)
    rows = np.searchsorted(known, wanted.astype(known.dtype, copy=False)).clip(max=len(known) - 1)
    return np.where(known[rows] == wanted, rows, -1)


def _some(part: Part, normals: NDArray[np.float32] | None, rows: slice) -> Piece:
    """Return some triangles of a piece."""
    mesh = part.mesh
    triangles = mesh.triangles[rows]
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[triangles] = True
    vertices, index = mesh.vertices[used], np.cumsum(used, dtype=np.int32) - np.int32(1)
    return Piece(
        Mesh(vertices, index[triangles], None if mesh.colors is None else mesh.colors[used]),
        np.stack([vertices.min(axis=0), vertices.max(axis=0)]),
        None if normals is None else normals[used],
        part.numbers[used],
    )


class OnePiece:
    """A mesh that memory holds, as the only piece of itself: for what works piece by piece on either.

    Parameters
    ----------
    mesh : with at least one triangle.

    Attributes
    ----------
    triangle_count, vertex_count, box, area : as of `Piecewise`.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.triangle_count, self.vertex_count = len(mesh.triangles), len(mesh.vertices)
        self.box = bounding_box(mesh)
        self.area = float(areas(mesh.vertices, mesh.triangles).sum())
        self._normals = vertex_normals(mesh).astype(np.float32)
        self._piece = Piece(mesh, self.box, self._normals, np.arange(self.vertex_count))

    def pieces(self, *, facing: bool = False) -> Iterator[Piece]:  # noqa: ARG002
        """Yield the piece, each time the same one; it has normals in any case."""
        yield self._piece

    def parts(self) -> Iterator[Part]:
        """Yield the piece with its own vertices, which are all."""
        yield Part(self._piece.mesh, self._piece.numbers, self.vertex_count)

    def normals(self, part: Part) -> NDArray[np.float32]:  # noqa: ARG002
        """Return the unit normals (n, 3) of the vertices."""
        return self._normals
