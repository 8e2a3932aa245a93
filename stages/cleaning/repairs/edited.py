"""A mesh under repair: its triangles keep their numbers, and every edit can be undone.

A corner of a triangle is always one of the corners that were given, with its vertex, texture coordinate and
normal: repairs invent none, so one number a corner says all. An edit remembers which triangles it looked at;
undoing it undoes those later ones that looked at what it wrote, and leaves what would be had it never been.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Vertices
from scanloom.stages.surface.vertex_normals import vertex_normals
from scanloom.stages.surface.welding import same_rows

# The number of the corners of a triangle that is gone.
GONE = -1


@dataclass(frozen=True, eq=False)
class Round:
    """Edits that were made at once, none of which looks at what another writes.

    Attributes
    ----------
    seen : (k,) edits and (k,) triangles they looked at.
    written : (w,) edits, (w,) triangles, which are among those seen, and their corners (w, 3) before.
    moved : (v,) edits, (v,) vertices they moved, and their places (v, 3) before.
    """

    seen: tuple[Ids, Ids]
    written: tuple[Ids, Ids, Ids]
    moved: tuple[Ids, Ids, Vertices]

    def without(self, undone: NDArray[np.bool_]) -> Round:
        """Return what is left of it without some edits, given as a mask of all."""
        seen, written, moved = self.seen, self.written, self.moved
        a, b, c = (~undone[edits[0]] for edits in (seen, written, moved))
        return replace(
            self,
            seen=(seen[0][a], seen[1][a]),
            written=(written[0][b], written[1][b], written[2][b]),
            moved=(moved[0][c], moved[1][c], moved[2][c]),
        )


@dataclass(eq=False)
class Edited:
    """A mesh and the edits of it.

    Attributes
    ----------
    first : (n,) for each vertex the first one in its place; vertices in one place are one here.
    corner : (m, 3) the given corner that each corner is; GONE in triangles that are gone.
    triangles : (m, 3) by the first vertex in each place; GONE in triangles that are gone.
    places : (n, 3) m, of the first vertex in each place.
    edits : how many were made, those undone included.
    """

    mesh: Mesh
    first: Ids
    corner: Ids
    triangles: Ids
    places: Vertices
    rounds: list[Round] = field(default_factory=list)
    edits: int = 0

    @classmethod
    def start(cls, mesh: Mesh) -> Edited:
        """Return a mesh without edits."""
        corner = np.arange(3 * len(mesh.triangles)).reshape(-1, 3)
        first = same_rows(list(mesh.vertices.T))
        return cls(mesh, first, corner, first[mesh.triangles], mesh.vertices.copy())

    def given_triangles(self) -> Ids:
        """Return the triangles (m, 3) before all edits, by the first vertex in each place."""
        return np.asarray(self.first[self.mesh.triangles])

    def vertex_of(self, corner: Ids) -> Ids:
        """Return the first vertex in the place of each given corner; GONE stays."""
        vertex = self.first[self.mesh.triangles.reshape(-1)[corner]]
        return np.where(corner == GONE, GONE, vertex)

    def is_there(self, rows: Ids) -> NDArray[np.bool_]:
        """Return which triangles are not gone."""
        return np.asarray(self.corner[rows, 0] != GONE)

    def is_moved(self) -> NDArray[np.bool_]:
        """Return (n,) which vertices are elsewhere; of several in one place, the first."""
        moved = np.zeros(len(self.first), bool)
        for made in self.rounds:
            moved[made.moved[1]] = True
        return moved

    def changed(self) -> Ids:
        """Return the triangles that some edit has written, ascending."""
        written = [made.written[1] for made in self.rounds]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *written]))

    def make(
        self,
        seen: tuple[Ids, Ids],
        written: tuple[Ids, Ids, Ids],
        moved: tuple[Ids, Ids, Vertices],
        count: int,
    ) -> Ids:
        """Make `count` edits, numbered from 0 in what is given, and return the numbers they get.

        `written` has the triangles' corners after the edits, `moved` the new places.
        """
        numbers = np.arange(self.edits, self.edits + count)
        self.edits += count
        before = self.corner[written[1]], self.places[moved[1]]
        self._write(written[1], written[2])
        self.places[moved[1]] = moved[2]
        made = Round(
            (numbers[seen[0]], seen[1]),
            (numbers[written[0]], written[1], before[0]),
            (numbers[moved[0]], moved[1], before[1]),
        )
        self.rounds.append(made)
        return numbers

    def writers(self, rows: Ids) -> Ids:
        """Return the edits that wrote some of these triangles."""
        wanted = np.zeros(len(self.corner), bool)
        wanted[rows] = True
        found = [made.written[0][wanted[made.written[1]]] for made in self.rounds]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *found]))

    def undo(self, edits: Ids) -> tuple[Ids, Ids]:
        """Undo edits and those that rest on them; return all of these, and the triangles they wrote."""
        undone = np.zeros(self.edits, bool)
        undone[edits] = True
        tainted = np.zeros(len(self.corner), bool)
        for made in self.rounds:
            undone[made.seen[0][tainted[made.seen[1]]]] = True
            tainted[made.written[1][undone[made.written[0]]]] = True
        for made in reversed(self.rounds):
            of_written, of_moved = undone[made.written[0]], undone[made.moved[0]]
            self._write(made.written[1][of_written], made.written[2][of_written])
            self.places[made.moved[1][of_moved]] = made.moved[2][of_moved]
        self.rounds = [made.without(undone) for made in self.rounds]
        return np.flatnonzero(undone), np.flatnonzero(tainted)

    def _write(self, rows: Ids, corner: Ids) -> None:
        self.corner[rows] = corner
        self.triangles[rows] = self.vertex_of(corner)


def repaired_mesh(edited: Edited) -> tuple[Mesh, Ids, Ids]:
    """Return the repaired mesh, and the given vertex and triangle of each of its vertices and triangles.

    Attributes of vertices, corners and triangles are carried over.
    """
    given = edited.mesh
    (rows,) = np.nonzero(edited.is_there(np.arange(len(edited.corner))))
    if not edited.rounds:
        return given, np.arange(len(given.vertices)), rows
    corner = edited.corner[rows]
    uvs = None if given.texture is None else given.texture.uvs.reshape(-1, 2)[corner]
    normals = None if given.corner_normals is None else given.corner_normals.reshape(-1, 3)[corner]
    triangles = given.triangles.reshape(-1)[corner]
    mesh = _with_moved(edited, given.with_triangles(triangles, rows, uvs=uvs, corner_normals=normals))
    # Vertices that were unused before stay; those that a collapse leaves unused are removed.
    used, still = np.zeros((2, len(given.vertices)), bool)
    used[given.triangles] = True
    still[triangles] = True
    (kept,) = np.nonzero(still | ~used)
    number = np.cumsum(still | ~used) - 1
    mesh = mesh.with_(
        vertices=mesh.vertices[kept],
        colors=None if mesh.colors is None else mesh.colors[kept],
        normals=None if mesh.normals is None else mesh.normals[kept],
        triangles=number[triangles].astype(np.int32),
    )
    return mesh, kept, rows


def _with_moved(edited: Edited, mesh: Mesh) -> Mesh:
    """Return the mesh with its moved vertices in their new positions, and normals to match."""
    (moved,) = np.nonzero(edited.is_moved()[edited.first])
    if len(moved) == 0:
        return mesh
    vertices = mesh.vertices.copy()
    vertices[moved] = edited.places[edited.first[moved]]
    mesh = mesh.with_(vertices=vertices)
    if mesh.normals is None and mesh.corner_normals is None:
        return mesh
    fitting = vertex_normals(mesh)
    if mesh.normals is not None:
        normals = mesh.normals.copy()
        normals[moved] = fitting[moved]
        mesh = mesh.with_(normals=normals)
    if mesh.corner_normals is not None:
        corner_normals = mesh.corner_normals.copy()
        there = np.isin(mesh.triangles, moved)
        corner_normals[there] = fitting[mesh.triangles[there]]
        mesh = mesh.with_(corner_normals=corner_normals)
    return mesh
