"""A mesh in memory, split into chunks of consecutive triangles.

A search structure takes twenty times the memory of the mesh, so it is built per chunk. Consecutive triangles
of scan meshes are near each other, so each chunk is compact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.memory import give_back
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.pieces import Part, counted_from

# Triangles per chunk.
_LENGTH = 500_000


class Runs:
    """Chunks of a mesh in memory, with the reading interface of `Pieces`.

    Vertices are renumbered by the first chunk that uses them. Unused vertices are dropped.

    Parameters
    ----------
    mesh : mesh of which vertices, triangles and vertex colours are used.

    Attributes
    ----------
    vertex_count, triangle_count : totals over all chunks.
    has_colors : True if vertices have colours.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.triangle_count, self.has_colors = len(mesh.triangles), mesh.colors is not None
        first = np.full(len(mesh.vertices), len(self), np.int32)
        for number in reversed(range(len(self))):
            first[mesh.triangles[_rows(number)]] = number
        order = np.argsort(first, kind="stable")
        # End of the vertex range that each chunk uses first.
        self._ends = np.searchsorted(first[order], np.arange(len(self)), "right")
        self.vertex_count = int(self._ends[-1]) if len(self) else 0
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order), dtype=np.int32)
        used = order[: self.vertex_count]
        self._vertices, self._triangles = mesh.vertices[used], rank[mesh.triangles]
        self._colors = None if mesh.colors is None else mesh.colors[used]

    def __len__(self) -> int:
        """Return the number of chunks."""
        return -(-self.triangle_count // _LENGTH)

    def part(self, number: int) -> Part:
        """Return a chunk."""
        # Processing the previous chunk fragmented the heap; without this, memory grows from chunk to chunk.
        give_back()
        first, end = (0 if number == 0 else int(self._ends[number - 1])), int(self._ends[number])
        numbers, local = counted_from(first, end, self._triangles[_rows(number)])
        colors = None if self._colors is None else self._colors[numbers]
        return Part(Mesh(self._vertices[numbers], local, colors), numbers, end - first)

    def places(self, step: int) -> NDArray[np.float64]:
        """Return every `step`-th vertex as positions (k, 3), metres."""
        return self._vertices[::step]


def _rows(number: int) -> slice:
    return slice(number * _LENGTH, (number + 1) * _LENGTH)
