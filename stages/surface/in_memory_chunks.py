"""A mesh in memory, split into chunks of consecutive triangles.

A search structure takes twenty times the memory of the mesh, so it is built per chunk. Consecutive triangles
of scan meshes are near each other, so each chunk is compact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.chunked_ply import MeshChunk, localize_indices
from scanloom.stages.surface.memory_release import release_free_memory
from scanloom.stages.surface.mesh import Mesh

# Triangles per chunk.
_CHUNK_TRIANGLES = 500_000


class InMemoryChunks:
    """Chunks of a mesh in memory, with the reading interface of `ChunkedPly`.

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
            first[mesh.triangles[_get_triangle_range(number)]] = number
        order = np.argsort(first, kind="stable")
        # End of the vertex range that each chunk uses first.
        self._first_use_ends = np.searchsorted(first[order], np.arange(len(self)), "right")
        self.vertex_count = int(self._first_use_ends[-1]) if len(self) else 0
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order), dtype=np.int32)
        used = order[: self.vertex_count]
        self._vertices, self._triangles = mesh.vertices[used], rank[mesh.triangles]
        self._colors = None if mesh.colors is None else mesh.colors[used]

    def __len__(self) -> int:
        """Return the number of chunks."""
        return -(-self.triangle_count // _CHUNK_TRIANGLES)

    def read_chunk(self, index: int) -> MeshChunk:
        """Return a chunk."""
        # Processing the previous chunk fragmented the heap; without this, memory grows from chunk to chunk.
        release_free_memory()
        first, end = (
            (0 if index == 0 else int(self._first_use_ends[index - 1])),
            int(self._first_use_ends[index]),
        )
        numbers, local = localize_indices(first, end, self._triangles[_get_triangle_range(index)])
        colors = None if self._colors is None else self._colors[numbers]
        return MeshChunk(Mesh(self._vertices[numbers], local, colors), numbers, end - first)

    def sample_vertices(self, step: int) -> NDArray[np.float64]:
        """Return every `step`-th vertex as positions (k, 3), metres."""
        return self._vertices[::step]


def _get_triangle_range(number: int) -> slice:
    return slice(number * _CHUNK_TRIANGLES, (number + 1) * _CHUNK_TRIANGLES)
