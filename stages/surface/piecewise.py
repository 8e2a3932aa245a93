"""Chunked access to large meshes.

Triangles are processed in batches, with vertex normals and areas of the whole mesh.
"""

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

# Approximate number of sampled vertices. The distance to the nearest one is an upper bound of the distance to
# the surface.
_LANDMARKS = 200_000
# Relative error allowed in that nearest-neighbour search.
_ROUGHLY = 0.1
# Triangles per batch. A search structure takes about 1 kB per triangle.
AT_ONCE = 250_000
# Triangles up to which a mesh in memory is not split into chunks.
_FEW = 1_000_000


@dataclass(frozen=True, eq=False)
class Piece:
    """A batch of at most AT_ONCE triangles of a chunk.

    Attributes
    ----------
    mesh : the triangles with the vertices in use.
    box : (2, 3) minimum and maximum corner of the bounding box, metres.
    normals : (n, 3) float32 unit vertex normals of the whole mesh; None if not requested.
    numbers : (n,) int64, index of each vertex in the whole mesh.
    """

    mesh: Mesh
    box: Floats
    normals: NDArray[np.float32] | None
    numbers: NDArray[np.int64]


def piecewise(mesh: Mesh) -> Mesh | Piecewise:
    """Wrap a large mesh for chunked processing; return a small one unchanged."""
    return mesh if len(mesh.triangles) <= _FEW else Piecewise(Runs(mesh))


class Piecewise:
    """A mesh that is processed chunk by chunk.

    Memory holds one chunk, and the normals of vertices shared between chunks. The constructor reads all
    chunks once.

    Parameters
    ----------
    pieces : chunks of a file or of a mesh in memory.

    Attributes
    ----------
    has_colors : True if vertices have colours.
    triangle_count, vertex_count : totals over all chunks.
    box : (2, 3) minimum and maximum corner of the bounding box of all triangles, metres.
    area_ends : (p,) cumulative area up to the end of each chunk, m².

    Raises
    ------
    InputError
        If a file is damaged, or the chunk table does not match it.
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
        """Return the number of chunks."""
        return len(self._pieces)

    @property
    def area(self) -> float:
        """Total area of all triangles, m²."""
        return float(self.area_ends[-1])

    def areas_up_to(self, number: int, mesh: Mesh) -> Floats:
        """Return the cumulative area (m + 1,) along a chunk's triangles, m².

        The first value is the area of all chunks before.
        """
        before = self.area_ends[number - 1] if number else 0.0
        some = (mesh.triangles[first : first + AT_ONCE] for first in range(0, len(mesh.triangles), AT_ONCE))
        return np.cumsum(np.concatenate([[before], *(areas(mesh.vertices, rows) for rows in some)]))

    def mesh(self, number: int) -> Mesh:
        """Read a chunk as a mesh."""
        return self._pieces.part(number).mesh

    def pieces(self, *, facing: bool = False) -> Iterator[Piece]:
        """Yield all triangles in batches of at most AT_ONCE.

        Parameters
        ----------
        facing : True to compute vertex normals.
        """
        for number in range(len(self._pieces)):
            part = self._pieces.part(number)
            normals = self.normals(part) if facing else None
            # Consecutive triangles of a chunk are near each other, so a batch is compact.
            for first in range(0, len(part.mesh.triangles), AT_ONCE):
                yield _some(part, normals, slice(first, first + AT_ONCE))

    def parts(self) -> Iterator[Part]:
        """Iterate over the chunks."""
        return (self._pieces.part(number) for number in range(len(self._pieces)))

    def some_vertices(self, wanted: int) -> Floats:
        """Return about `wanted` vertex positions (k, 3), sampled at equal index steps."""
        return self._pieces.places(1 + self._pieces.vertex_count // wanted)

    def at_most(self, points: Floats) -> Floats:
        """Return an upper bound (k,) of each point's distance to the surface, metres."""
        # Any sampled vertex gives a valid bound. An approximate search is much faster for distant points.
        return np.asarray(self._tree.query(points, eps=_ROUGHLY, workers=-1)[0], np.float64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self._landmarks, balanced_tree=False)

    def normals(self, part: Part) -> NDArray[np.float32]:
        """Compute a chunk's unit vertex normals (n, 3), including triangles of other chunks."""
        sums = normal_sums(part.mesh)
        numbers, of_all = self._shared
        rows = rows_of(numbers, part.numbers)
        sums[rows >= 0] = of_all[rows[rows >= 0]]
        return unit(sums).astype(np.float32)

    @cached_property
    def _shared(self) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Vertices used by several chunks: indices (s,) and normal sums (s, 3).

        There are many of them where a wall or floor runs along a chunk boundary.
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
    """Return each wanted value's position in the sorted array `known`; −1 if missing."""
    if not len(known):
        return np.full(len(wanted), -1)
    rows = np.searchsorted(known, wanted.astype(known.dtype, copy=False)).clip(max=len(known) - 1)
    return np.where(known[rows] == wanted, rows, -1)


def _some(part: Part, normals: NDArray[np.float32] | None, rows: slice) -> Piece:
    """Extract a range of a chunk's triangles as a batch."""
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
    """A mesh in memory with the interface of `Piecewise`.

    The whole mesh is one chunk and one batch.

    Parameters
    ----------
    mesh : mesh with at least one triangle.

    Attributes
    ----------
    triangle_count, vertex_count, box, area : as in `Piecewise`.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.triangle_count, self.vertex_count = len(mesh.triangles), len(mesh.vertices)
        self.box = bounding_box(mesh)
        self.area = float(areas(mesh.vertices, mesh.triangles).sum())
        self._normals = vertex_normals(mesh).astype(np.float32)
        self._piece = Piece(mesh, self.box, self._normals, np.arange(self.vertex_count))

    def pieces(self, *, facing: bool = False) -> Iterator[Piece]:  # noqa: ARG002
        """Yield the only batch; it always has normals."""
        yield self._piece

    def parts(self) -> Iterator[Part]:
        """Yield the only chunk, which owns all vertices."""
        yield Part(self._piece.mesh, self._piece.numbers, self.vertex_count)

    def normals(self, part: Part) -> NDArray[np.float32]:  # noqa: ARG002
        """Return the unit vertex normals (n, 3)."""
        return self._normals
