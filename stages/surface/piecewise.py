"""A mesh in pieces, of which one at a time is worked on as if the others were there.

Alone, a piece does not know how the surface goes on behind its rim: normals there would be other ones than
those of the whole. So each comes with the triangles of others that touch its vertices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.surface.mesh import Mesh
from stages.surface.pieces import Part, Pieces
from stages.surface.raycasting import Floats, bounding_box
from stages.surface.topology import areas

Numbers = NDArray[np.int64]

# Vertices that are kept of all of them, about: no point is farther from the surface than from one of these.
_LANDMARKS = 200_000
# Triangles that are worked on at a time: to search them takes about a kilobyte for each.
AT_ONCE = 500_000


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece, or of one with many triangles some of them.

    Attributes
    ----------
    mesh : its triangles.
    around : the same vertices and triangles, and then those others that touch them: normals of all that
        `mesh` has are those of the whole.
    box : (2, 3) lowest and highest corner around its triangles, metres.
    """

    mesh: Mesh
    around: Mesh
    box: Floats


class Piecewise:
    """A PLY file in pieces, looked over.

    Beside a piece, memory holds the triangles along the faces where pieces meet, a few in a hundred.

    Parameters
    ----------
    path : of the file, with its table of pieces beside it: what fusion and cleaning leave.

    Attributes
    ----------
    has_colors : whether vertices have colours.
    box : (2, 3) lowest and highest corner around all triangles, metres.
    area_ends : (p,) area of the pieces up to and with each, m²: sums over all their triangles in order.

    Raises
    ------
    InputError
        If the files are damaged, or do not fit each other.
    """

    def __init__(self, path: Path) -> None:
        self._pieces = Pieces(path)
        self.has_colors = self._pieces.has_colors
        count = len(self._pieces)
        self.box = np.stack([np.full(3, np.inf), np.full(3, -np.inf)])
        self.area_ends = np.zeros(count)
        step = 1 + self._pieces.triangle_count // _LANDMARKS
        landmarks, named = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
        for number in range(count):
            part = self._pieces.part(number)
            self.area_ends[number] = self.areas_up_to(number, part.mesh)[-1]
            if len(part.mesh.triangles):
                low, high = bounding_box(part.mesh)
                self.box = np.stack([np.minimum(self.box[0], low), np.maximum(self.box[1], high)])
            landmarks.append(part.mesh.vertices[part.mesh.triangles[::step, 0]])
            named.append(part.numbers[part.own :])
        self._landmarks = np.concatenate(landmarks)
        self._rims = _rims(self._pieces, np.unique(np.concatenate(named)))

    def __len__(self) -> int:
        """Return how many pieces there are."""
        return len(self._pieces)

    @property
    def triangle_count(self) -> int:
        """How many triangles all pieces have."""
        return self._pieces.triangle_count

    def areas_up_to(self, number: int, mesh: Mesh) -> Floats:
        """Return what `area_ends` is after each triangle of a piece (m,), after the one before it first."""
        before = self.area_ends[number - 1] if number else 0.0
        return np.cumsum(np.concatenate([[before], areas(mesh.vertices, mesh.triangles)]))

    def mesh(self, number: int) -> Mesh:
        """Read the triangles of a piece."""
        return self._pieces.part(number).mesh

    def pieces(self) -> Iterator[Piece]:
        """Read one after the other, each with so many triangles that much can be done with it."""
        for number in range(len(self._pieces)):
            part = self._pieces.part(number)
            around = self._rims.around(number, part)
            count = len(part.mesh.triangles)
            # What follows on each other in a piece is near each other.
            for first in range(0, count, AT_ONCE):
                yield _cut(part.mesh, around, slice(first, min(first + AT_ONCE, count)))

    def some_vertices(self, wanted: int) -> Floats:
        """Return about so many vertices (k, 3), at equal steps through all."""
        return self._pieces.places(1 + self._pieces.vertex_count // wanted)

    def at_most(self, points: Floats) -> Floats:
        """Return distances (k,) that points are no farther from the surface than, metres."""
        return np.asarray(self._tree.query(points, workers=-1)[0], np.float64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self._landmarks, balanced_tree=False)


def _cut(mesh: Mesh, around: Mesh, rows: slice) -> Piece:
    """Return some triangles of a mesh, with what touches them of itself and of what is around it."""
    own = np.zeros(len(around.triangles), np.bool_)
    own[rows] = True
    used = np.zeros(len(around.vertices), np.bool_)
    used[mesh.triangles[rows]] = True
    touching = used[around.triangles].any(axis=1) & ~own
    count = int(used.sum())
    beyond = np.zeros(len(used), np.bool_)
    beyond[around.triangles[touching]] = True
    beyond &= ~used
    index = np.zeros(len(used), np.int32)
    index[used] = np.arange(count)
    index[beyond] = count + np.arange(int(beyond.sum()))
    triangles = index[mesh.triangles[rows]]
    vertices = around.vertices[used]
    colors = None if mesh.colors is None else mesh.colors[used[: len(mesh.vertices)]]
    return Piece(
        Mesh(vertices, triangles, colors),
        Mesh(
            np.concatenate([vertices, around.vertices[beyond]]),
            np.concatenate([triangles, index[around.triangles[touching]]]),
        ),
        np.stack([vertices.min(axis=0), vertices.max(axis=0)]),
    )


class _Rims:
    """Triangles with a vertex that several pieces name.

    Parameters
    ----------
    shared : (s,) numbers in all of these vertices, ascending.
    triangles : (k, 3) numbers in all; owners : (k,) the piece each is of.
    numbers, places : (v,), (v, 3) of all vertices they have, by number.
    """

    def __init__(
        self, shared: Numbers, triangles: Numbers, owners: Numbers, numbers: Numbers, places: Floats
    ) -> None:
        self._shared, self._triangles, self._owners = shared, triangles, owners
        self._numbers, self._places = numbers, places
        corners = triangles.reshape(-1)
        self._order = np.argsort(corners, kind="stable")
        self._sorted = corners[self._order]

    def around(self, number: int, part: Part) -> Mesh:
        """Return the mesh of a piece, with those triangles of others that touch its vertices."""
        (local,) = np.nonzero(np.isin(part.numbers, self._shared))
        local = local[np.argsort(part.numbers[local])]
        mine = part.numbers[local]
        rows = np.unique(_between(self._order, self._sorted, mine) // 3)
        others = self._triangles[rows[self._owners[rows] != number]]
        # Whatever of them the piece has, too, is named by both and so shared.
        is_mine = np.isin(others, mine)
        new, place = np.unique(others[~is_mine], return_inverse=True)
        triangles = np.empty(others.shape, np.int32)
        triangles[is_mine] = local[np.searchsorted(mine, others[is_mine])]
        triangles[~is_mine] = len(part.numbers) + place.reshape(-1)
        places = self._places[np.searchsorted(self._numbers, new)]
        return Mesh(
            np.concatenate([part.mesh.vertices, places]), np.concatenate([part.mesh.triangles, triangles])
        )


def _rims(pieces: Pieces, shared: Numbers) -> _Rims:
    """Read the triangles of all pieces that have a vertex among those that several name."""
    triangles, owners = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    numbers, places = [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    for number in range(len(pieces)):
        part = pieces.part(number)
        is_shared = np.isin(part.numbers, shared)
        found = part.mesh.triangles[is_shared[part.mesh.triangles].any(axis=1)]
        used = np.unique(found)
        triangles.append(part.numbers[found])
        owners.append(np.full(len(found), number))
        numbers.append(part.numbers[used])
        places.append(part.mesh.vertices[used])
    distinct, first = np.unique(np.concatenate(numbers), return_index=True)
    return _Rims(
        shared, np.concatenate(triangles), np.concatenate(owners), distinct, np.concatenate(places)[first]
    )


def _between(values: Numbers, keys: Numbers, wanted: Numbers) -> Numbers:
    """Return the values whose keys, ascending, are among those wanted."""
    first, end = (np.searchsorted(keys, wanted, side) for side in ("left", "right"))
    count = end - first
    places = np.repeat(first - (np.cumsum(count) - count), count) + np.arange(count.sum())
    return np.asarray(values[places])
