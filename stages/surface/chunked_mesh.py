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

from scanloom.stages.surface.chunked_ply import ChunkedPly, MeshChunk
from scanloom.stages.surface.in_memory_chunks import InMemoryChunks
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, compute_bounding_box
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.surface.vertex_normals import compute_vertex_normals, normalize_vectors, sum_normals

# Approximate number of sampled vertices. The distance to the nearest one is an upper bound of the distance to
# the surface.
_LANDMARK_COUNT = 200_000
# Relative error allowed in that nearest-neighbour search.
_SEARCH_TOLERANCE = 0.1
# Triangles per batch. A search structure takes about 1 kB per triangle.
BATCH_TRIANGLES = 250_000
# Triangles up to which a mesh in memory is not split into chunks.
_MAX_SINGLE_CHUNK_TRIANGLES = 1_000_000


@dataclass(frozen=True, eq=False)
class TriangleBatch:
    """A batch of at most BATCH_TRIANGLES triangles of a chunk.

    Attributes
    ----------
    mesh : the triangles with the vertices in use.
    box : (2, 3) minimum and maximum corner of the bounding box, metres.
    normals : (n, 3) float32 unit vertex normals of the whole mesh; None if not requested.
    global_indices : (n,) int64, index of each vertex in the whole mesh.
    """

    mesh: Mesh
    box: Floats
    normals: NDArray[np.float32] | None
    global_indices: NDArray[np.int64]


def wrap_large_mesh(mesh: Mesh) -> Mesh | ChunkedMesh:
    """Wrap a large mesh for chunked processing; return a small one unchanged."""
    return mesh if len(mesh.triangles) <= _MAX_SINGLE_CHUNK_TRIANGLES else ChunkedMesh(InMemoryChunks(mesh))


class ChunkedMesh:
    """A mesh that is processed chunk by chunk.

    Memory holds one chunk, and the normals of vertices shared between chunks. The constructor reads all
    chunks once.

    Parameters
    ----------
    iterate_batches : chunks of a file or of a mesh in memory.

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

    def __init__(self, chunks: ChunkedPly | InMemoryChunks) -> None:
        self._chunks = chunks
        self.has_colors = self._chunks.has_colors
        self.triangle_count = self._chunks.triangle_count
        self.vertex_count = self._chunks.vertex_count
        count = len(self._chunks)
        self.box = np.stack([np.full(3, np.inf), np.full(3, -np.inf)])
        self.area_ends = np.zeros(count)
        step = 1 + self._chunks.triangle_count // _LANDMARK_COUNT
        landmarks = [np.zeros((0, 3))]
        for number in range(count):
            mesh = self.read_mesh(number)
            self.area_ends[number] = self.accumulate_areas(number, mesh)[-1]
            landmarks.append(mesh.vertices[mesh.triangles[::step, 0]])
            if len(mesh.triangles):
                low, high = compute_bounding_box(mesh)
                self.box = np.stack([np.minimum(self.box[0], low), np.maximum(self.box[1], high)])
        self._landmarks = np.concatenate(landmarks)

    def __len__(self) -> int:
        """Return the number of chunks."""
        return len(self._chunks)

    @property
    def area(self) -> float:
        """Total area of all triangles, m²."""
        return float(self.area_ends[-1])

    def accumulate_areas(self, index: int, mesh: Mesh) -> Floats:
        """Return the cumulative area (m + 1,) along a chunk's triangles, m².

        The first value is the area of all chunks before.
        """
        before = self.area_ends[index - 1] if index else 0.0
        some = (
            mesh.triangles[first : first + BATCH_TRIANGLES]
            for first in range(0, len(mesh.triangles), BATCH_TRIANGLES)
        )
        return np.cumsum(np.concatenate([[before], *(compute_areas(mesh.vertices, rows) for rows in some)]))

    def read_mesh(self, index: int) -> Mesh:
        """Read a chunk as a mesh."""
        return self._chunks.read_chunk(index).mesh

    def iterate_batches(self, *, with_normals: bool = False) -> Iterator[TriangleBatch]:
        """Yield all triangles in batches of at most BATCH_TRIANGLES.

        Parameters
        ----------
        with_normals : True to compute vertex normals.
        """
        for number in range(len(self._chunks)):
            part = self._chunks.read_chunk(number)
            normals = self.compute_normals(part) if with_normals else None
            # Consecutive triangles of a chunk are near each other, so a batch is compact.
            for first in range(0, len(part.mesh.triangles), BATCH_TRIANGLES):
                yield _extract_batch(part, normals, slice(first, first + BATCH_TRIANGLES))

    def iterate_chunks(self) -> Iterator[MeshChunk]:
        """Iterate over the chunks."""
        return (self._chunks.read_chunk(number) for number in range(len(self._chunks)))

    def sample_vertices(self, count: int) -> Floats:
        """Return about `count` vertex positions (k, 3), sampled at equal index steps."""
        return self._chunks.sample_vertices(1 + self._chunks.vertex_count // count)

    def bound_distances(self, points: Floats) -> Floats:
        """Return an upper bound (k,) of each point's distance to the surface, metres."""
        # Any sampled vertex gives a valid bound. An approximate search is much faster for distant points.
        return np.asarray(self._tree.query(points, eps=_SEARCH_TOLERANCE, workers=-1)[0], np.float64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self._landmarks, balanced_tree=False)

    def compute_normals(self, chunk: MeshChunk) -> NDArray[np.float32]:
        """Compute a chunk's unit vertex normals (n, 3), including triangles of other chunks."""
        sums = sum_normals(chunk.mesh)
        numbers, of_all = self._shared_normal_sums
        rows = find_sorted(numbers, chunk.global_indices)
        sums[rows >= 0] = of_all[rows[rows >= 0]]
        return normalize_vectors(sums).astype(np.float32)

    @cached_property
    def _shared_normal_sums(self) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Vertices used by several chunks: indices (s,) and normal sums (s, 3).

        There are many of them where a wall or floor runs along a chunk boundary.
        """
        named = [np.zeros(0, np.int32)]
        for number in range(len(self._chunks)):
            part = self._chunks.read_chunk(number)
            named.append(part.global_indices[part.own_count :].astype(np.int32))
        numbers = np.unique(np.concatenate(named))
        sums = np.zeros((len(numbers), 3), np.float32)
        for number in range(len(self._chunks)):
            part = self._chunks.read_chunk(number)
            rows = find_sorted(numbers, part.global_indices)
            sums[rows[rows >= 0]] += sum_normals(part.mesh)[rows >= 0].astype(np.float32)
        return numbers, sums


def find_sorted(known: NDArray[np.integer[Any]], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return each wanted value's position in the sorted array `known`; −1 if missing."""
    if not len(known):
        return np.full(len(wanted), -1)
    rows = np.searchsorted(known, wanted.astype(known.dtype, copy=False)).clip(max=len(known) - 1)
    return np.where(known[rows] == wanted, rows, -1)


def _extract_batch(chunk: MeshChunk, normals: NDArray[np.float32] | None, rows: slice) -> TriangleBatch:
    """Extract a range of a chunk's triangles as a batch."""
    mesh = chunk.mesh
    triangles = mesh.triangles[rows]
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[triangles] = True
    vertices, index = mesh.vertices[used], np.cumsum(used, dtype=np.int32) - np.int32(1)
    return TriangleBatch(
        Mesh(vertices, index[triangles], None if mesh.colors is None else mesh.colors[used]),
        np.stack([vertices.min(axis=0), vertices.max(axis=0)]),
        None if normals is None else normals[used],
        chunk.global_indices[used],
    )


class SingleChunkMesh:
    """A mesh in memory with the interface of `ChunkedMesh`.

    The whole mesh is one chunk and one batch.

    Parameters
    ----------
    mesh : mesh with at least one triangle.

    Attributes
    ----------
    triangle_count, vertex_count, box, area : as in `ChunkedMesh`.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.triangle_count, self.vertex_count = len(mesh.triangles), len(mesh.vertices)
        self.box = compute_bounding_box(mesh)
        self.area = float(compute_areas(mesh.vertices, mesh.triangles).sum())
        self._normals = compute_vertex_normals(mesh).astype(np.float32)
        self._batch = TriangleBatch(mesh, self.box, self._normals, np.arange(self.vertex_count))

    def iterate_batches(self, *, with_normals: bool = False) -> Iterator[TriangleBatch]:  # noqa: ARG002
        """Yield the mesh as a single batch, with normals."""
        yield self._batch

    def iterate_chunks(self) -> Iterator[MeshChunk]:
        """Yield the only chunk, which owns all vertices."""
        yield MeshChunk(self._batch.mesh, self._batch.global_indices, self.vertex_count)

    def compute_normals(self, chunk: MeshChunk) -> NDArray[np.float32]:  # noqa: ARG002
        """Return the unit vertex normals (n, 3)."""
        return self._normals
