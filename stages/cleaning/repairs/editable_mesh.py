"""Mesh under repair, with edits that can be undone.

Triangles keep their indices. Each corner always refers to a corner of the input, with its vertex, texture
coordinate and normal. Repairs create no new corners. Each edit records the triangles it depends on. Undoing
an edit also undoes all later edits that depend on triangles it wrote.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Vertices
from scanloom.stages.surface.vertex_normals import compute_vertex_normals
from scanloom.stages.surface.welding import find_first_equal_rows

# Corner index in deleted triangles.
GONE = -1


@dataclass(frozen=True, eq=False)
class EditRound:
    """Independent edits that were made at once.

    No edit depends on a triangle that another one writes.

    Attributes
    ----------
    dependencies : edits (k,) and the triangles (k,) they depend on.
    written : edits (w,), triangles (w,) they wrote, a subset of `dependencies`, and the previous corners (w,
        3).
    moved : edits (v,), vertices (v,) they moved, and the previous positions (v, 3) in metres.
    """

    dependencies: tuple[Ids, Ids]
    written: tuple[Ids, Ids, Ids]
    moved: tuple[Ids, Ids, Vertices]

    def exclude(self, undone: NDArray[np.bool_]) -> EditRound:
        """Return a copy without the edits in a mask."""
        seen, written, moved = self.dependencies, self.written, self.moved
        a, b, c = (~undone[edits[0]] for edits in (seen, written, moved))
        return replace(
            self,
            dependencies=(seen[0][a], seen[1][a]),
            written=(written[0][b], written[1][b], written[2][b]),
            moved=(moved[0][c], moved[1][c], moved[2][c]),
        )


@dataclass(eq=False)
class EditableMesh:
    """Mesh under repair, with the history of its edits.

    Attributes
    ----------
    mesh : the input.
    first_vertex : (n,) first vertex at each vertex's position; duplicate vertices count as one.
    input_corners : (m, 3) input corner of each corner; GONE in deleted triangles.
    triangles : (m, 3) vertices, as first vertex at each position; GONE in deleted triangles.
    positions : (n, 3) positions in metres, up to date only for the first vertex at each position.
    rounds : edits that are in effect, in order.
    edit_count : number of edits ever made, including undone ones.
    """

    mesh: Mesh
    first_vertex: Ids
    input_corners: Ids
    triangles: Ids
    positions: Vertices
    rounds: list[EditRound] = field(default_factory=list)
    edit_count: int = 0

    @classmethod
    def start(cls, mesh: Mesh) -> EditableMesh:
        """Create the editable mesh, without edits."""
        corner = np.arange(3 * len(mesh.triangles)).reshape(-1, 3)
        first = find_first_equal_rows(list(mesh.vertices.T))
        return cls(mesh, first, corner, first[mesh.triangles], mesh.vertices.copy())

    def get_input_triangles(self) -> Ids:
        """Return the triangles (m, 3) before all edits.

        Vertices are represented by the first one at each position.
        """
        return np.asarray(self.first_vertex[self.mesh.triangles])

    def get_vertices(self, corner: Ids) -> Ids:
        """Return the first vertex at each input corner's position.

        GONE stays GONE.
        """
        vertex = self.first_vertex[self.mesh.triangles.reshape(-1)[corner]]
        return np.where(corner == GONE, GONE, vertex)

    def is_present(self, rows: Ids) -> NDArray[np.bool_]:
        """Return a mask of the triangles that are not deleted."""
        return np.asarray(self.input_corners[rows, 0] != GONE)

    def is_moved(self) -> NDArray[np.bool_]:
        """Return a mask (n,) of the moved vertices.

        Only the first of several duplicates is marked.
        """
        moved = np.zeros(len(self.first_vertex), bool)
        for made in self.rounds:
            moved[made.moved[1]] = True
        return moved

    def find_changed(self) -> Ids:
        """Return the triangles that edits have written, ascending."""
        written = [made.written[1] for made in self.rounds]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *written]))

    def apply_edits(
        self,
        dependencies: tuple[Ids, Ids],
        written: tuple[Ids, Ids, Ids],
        moved: tuple[Ids, Ids, Vertices],
        count: int,
    ) -> Ids:
        """Apply `count` independent edits, and return their indices.

        Parameters
        ----------
        dependencies, written, moved : as in `EditRound`, but with the new corners and positions instead of
            the
            previous ones. Edits are numbered from 0 within this call.
        count : number of edits.
        """
        numbers = np.arange(self.edit_count, self.edit_count + count)
        self.edit_count += count
        before = self.input_corners[written[1]], self.positions[moved[1]]
        self._write(written[1], written[2])
        self.positions[moved[1]] = moved[2]
        made = EditRound(
            (numbers[dependencies[0]], dependencies[1]),
            (numbers[written[0]], written[1], before[0]),
            (numbers[moved[0]], moved[1], before[1]),
        )
        self.rounds.append(made)
        return numbers

    def find_writers(self, rows: Ids) -> Ids:
        """Return the edits that wrote any of the given triangles."""
        wanted = np.zeros(len(self.input_corners), bool)
        wanted[rows] = True
        found = [made.written[0][wanted[made.written[1]]] for made in self.rounds]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *found]))

    def undo(self, edits: Ids) -> tuple[Ids, Ids]:
        """Undo edits, and all edits that depend on them.

        Returns
        -------
        Indices of the undone edits, and the triangles they had written.
        """
        undone = np.zeros(self.edit_count, bool)
        undone[edits] = True
        tainted = np.zeros(len(self.input_corners), bool)
        for made in self.rounds:
            undone[made.dependencies[0][tainted[made.dependencies[1]]]] = True
            tainted[made.written[1][undone[made.written[0]]]] = True
        for made in reversed(self.rounds):
            of_written, of_moved = undone[made.written[0]], undone[made.moved[0]]
            self._write(made.written[1][of_written], made.written[2][of_written])
            self.positions[made.moved[1][of_moved]] = made.moved[2][of_moved]
        self.rounds = [made.exclude(undone) for made in self.rounds]
        return np.flatnonzero(undone), np.flatnonzero(tainted)

    def _write(self, rows: Ids, corner: Ids) -> None:
        self.input_corners[rows] = corner
        self.triangles[rows] = self.get_vertices(corner)


def build_repaired_mesh(edited: EditableMesh) -> tuple[Mesh, Ids, Ids]:
    """Build the repaired mesh, with the attributes of vertices, corners and triangles.

    Returns
    -------
    mesh : Mesh
    vertex_source, triangle_source : input vertex of each vertex, and input triangle of each triangle.
    """
    given = edited.mesh
    (rows,) = np.nonzero(edited.is_present(np.arange(len(edited.input_corners))))
    if not edited.rounds:
        return given, np.arange(len(given.vertices)), rows
    corner = edited.input_corners[rows]
    uvs = None if given.texture is None else given.texture.uvs.reshape(-1, 2)[corner]
    normals = None if given.corner_normals is None else given.corner_normals.reshape(-1, 3)[corner]
    triangles = given.triangles.reshape(-1)[corner]
    mesh = _apply_moves(edited, given.with_triangles(triangles, rows, uvs=uvs, corner_normals=normals))
    # Vertices that the input does not use stay; vertices that repairs made unused are removed.
    was_used, is_still_used = np.zeros((2, len(given.vertices)), bool)
    was_used[given.triangles] = True
    is_still_used[triangles] = True
    (kept,) = np.nonzero(is_still_used | ~was_used)
    number = np.cumsum(is_still_used | ~was_used) - 1
    mesh = mesh.with_(
        vertices=mesh.vertices[kept],
        colors=None if mesh.colors is None else mesh.colors[kept],
        normals=None if mesh.normals is None else mesh.normals[kept],
        triangles=number[triangles].astype(np.int32),
    )
    return mesh, kept, rows


def _apply_moves(edited: EditableMesh, mesh: Mesh) -> Mesh:
    """Apply vertex positions that smoothing changed, and recompute the normals there."""
    (moved,) = np.nonzero(edited.is_moved()[edited.first_vertex])
    if len(moved) == 0:
        return mesh
    vertices = mesh.vertices.copy()
    vertices[moved] = edited.positions[edited.first_vertex[moved]]
    mesh = mesh.with_(vertices=vertices)
    if mesh.normals is None and mesh.corner_normals is None:
        return mesh
    fitting = compute_vertex_normals(mesh)
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
