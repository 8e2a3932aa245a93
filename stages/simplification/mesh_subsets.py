"""Subsets of a mesh that are simplified independently and joined afterwards.

A subset stores the global index of each vertex, and the vertices that it shares with other subsets. Shared
vertices stay fixed, so the joined mesh has no cracks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.surface.chunked_ply import ChunkExtent, MeshChunk
from scanloom.stages.surface.codes import MESH_FILE_DAMAGED
from scanloom.stages.surface.mesh import Mesh

# Candidate planes for halving, as quantiles of the triangles' centres.
_PLANE_QUANTILES = np.linspace(0.2, 0.8, 13)

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class MeshSubset:
    """Subset of the triangles of a mesh.

    Attributes
    ----------
    mesh : these triangles and their vertices.
    global_indices : (n,) int64, global index of each vertex.
    is_shared : (n,) bool, vertices shared with other subsets.
    """

    mesh: Mesh
    global_indices: Indices
    is_shared: Mask

    def find_locked_vertices(self) -> Mask:
        """Return a mask (n,) of shared vertices and their neighbours."""
        near, triangles = self.is_shared.copy(), self.mesh.triangles
        near[triangles[self.is_shared[triangles].any(axis=1)]] = True
        return np.asarray(near)


def make_full_subset(mesh: Mesh) -> MeshSubset:
    """Create a subset that contains a complete mesh."""
    count = len(mesh.vertices)
    return MeshSubset(mesh, np.arange(count), np.zeros(count, np.bool_))


def split_chunk(part: MeshChunk, extent: ChunkExtent, rim: float) -> tuple[MeshSubset, MeshSubset]:
    """Split a chunk into its interior and the strip along its faces.

    Parameters
    ----------
    part : chunk of a mesh.
    extent : bounding box of the chunk.
    rim : width of the strip, metres.
    """
    mesh = part.mesh
    low, high = np.array(extent.low) + rim, np.array(extent.high) - rim
    near = np.asarray(((mesh.vertices < low) | (mesh.vertices > high)).any(axis=1), np.bool_)
    is_strip = np.asarray(near[mesh.triangles].all(axis=1))
    if (mesh.triangles[~is_strip] >= part.own_count).any():
        raise StageError(
            MESH_FILE_DAMAGED,
            "chunks of the mesh share vertices farther from their faces than the voxel size allows",
            remedy="fuse again.",
        )
    full_subset = MeshSubset(mesh, part.global_indices, np.zeros(len(near), np.bool_))
    inside, strip = split_by_groups(full_subset, [np.flatnonzero(~is_strip), np.flatnonzero(is_strip)])
    return inside, strip


def join_subsets(subsets: Sequence[MeshSubset]) -> MeshSubset:
    """Join one or more subsets into one.

    Shared vertices stay marked as shared.
    """
    all_numbers = np.concatenate([cut.global_indices for cut in subsets])
    numbers, first, place = np.unique(all_numbers, return_index=True, return_inverse=True)
    is_shared = np.zeros(len(numbers), bool)
    np.logical_or.at(is_shared, place, np.concatenate([cut.is_shared for cut in subsets]))
    return MeshSubset(_merge_meshes([cut.mesh for cut in subsets], first, place), numbers, is_shared)


def split_subset(subset: MeshSubset, max_triangles: int) -> Iterator[MeshSubset]:
    """Split a subset into subsets of at most `max_triangles` triangles.

    The splitting planes cross few triangles. The subsets are yielded one by one to limit memory.
    """
    mesh = subset.mesh
    if len(mesh.triangles) <= max_triangles:
        yield subset
        return
    corners = mesh.vertices.astype(np.float32)[mesh.triangles]
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    del corners
    blocks = list(_divide_triangles(lows, highs, np.arange(len(lows), dtype=np.int32), max_triangles))
    del lows, highs
    yield from split_by_groups(subset, blocks)


def split_by_groups(subset: MeshSubset, groups: Sequence[NDArray[np.integer[Any]]]) -> Iterator[MeshSubset]:
    """Split a subset by groups of triangles that partition it."""
    mesh = subset.mesh
    seen, is_of_both = np.zeros(len(mesh.vertices), np.bool_), subset.is_shared.copy()
    for rows in groups:
        used = _find_used_vertices(mesh, rows)
        is_of_both |= used & seen
        seen |= used
    for rows in groups:
        used = _find_used_vertices(mesh, rows)
        place = np.cumsum(used, dtype=np.int32) - np.int32(1)
        colors = None if mesh.colors is None else mesh.colors[used]
        some = Mesh(mesh.vertices[used], place[mesh.triangles[rows]], colors)
        yield MeshSubset(some, subset.global_indices[used], is_of_both[used])


def _find_used_vertices(mesh: Mesh, rows: NDArray[np.integer[Any]]) -> Mask:
    """Return a mask (n,) of the vertices that some triangles use."""
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.triangles[rows]] = True
    return used


def _divide_triangles(
    lows: NDArray[np.float32], highs: NDArray[np.float32], rows: NDArray[np.int32], max_triangles: int
) -> Iterator[NDArray[np.int32]]:
    """Halve triangles recursively, by planes that cross few of them.

    A plane along a noisy floor would create borders everywhere.

    Parameters
    ----------
    lows, highs : (m, 3) bounding boxes of all triangles.
    rows : triangles to divide.
    max_triangles : maximum number of triangles per group.
    """
    if len(rows) <= max_triangles:
        yield rows
        return
    low, high = lows[rows], highs[rows]
    middles = (low + high) / 2
    planes = [(axis, at) for axis in range(3) for at in np.quantile(middles[:, axis], _PLANE_QUANTILES)]
    crossed = np.array([np.count_nonzero((low[:, i] < at) & (high[:, i] > at)) for i, at in planes])
    # A plane with all triangles on one side does not divide them.
    crossed[[not 0 < np.count_nonzero(middles[:, i] < at) < len(rows) for i, at in planes]] = len(rows)
    axis, at = planes[int(crossed.argmin())]
    # Triangles whose centres coincide cannot be separated by a plane.
    is_first = np.arange(len(rows)) < len(rows) // 2
    before = is_first if crossed.min() == len(rows) else middles[:, axis] < at
    del low, high, middles
    yield from _divide_triangles(lows, highs, rows[before], max_triangles)
    yield from _divide_triangles(lows, highs, rows[~before], max_triangles)


def get_shared_indices(subset: MeshSubset, simplified: SimplificationResult[Any]) -> Indices:
    """Return the global index of each shared vertex, −1 for others.

    Raises
    ------
    StageError
        If a shared vertex has moved, which would be a bug.
    """
    source = simplified.vertex_source
    stayed = subset.is_shared[source]
    if not np.array_equal(simplified.mesh.vertices[stayed], subset.mesh.vertices[source[stayed]]):
        raise StageError(MACHINE_BUG, "a locked vertex has moved, which is a bug in scanloom.")
    return np.where(stayed, subset.global_indices[source], -1)


def join_meshes(meshes: Sequence[tuple[Mesh, Indices]], count: int) -> Mesh:
    """Join meshes at vertices with equal global indices.

    Parameters
    ----------
    meshes : meshes, and the global index of each vertex, −1 for unshared vertices.
    count : number of global indices.
    """
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    given = np.concatenate([numbers for _, numbers in meshes])
    # Unshared vertices get unique keys beyond the global indices.
    own = np.where(given < 0, count + np.arange(len(given)), given)
    _, first, place = np.unique(own, return_index=True, return_inverse=True)
    # Number vertices in order of first occurrence.
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    place, first = rank[place], first[order]
    return _merge_meshes([mesh for mesh, _ in meshes], first, place)


def _merge_meshes(meshes: Sequence[Mesh], first: NDArray[np.intp], place: NDArray[np.intp]) -> Mesh:
    """Concatenate meshes and merge vertices.

    Parameters
    ----------
    first : for each merged vertex, its first occurrence in the concatenated vertices.
    place : merged vertex of each concatenated vertex.
    """
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    triangles = [place[mesh.triangles + start] for mesh, start in zip(meshes, offsets, strict=True)]
    colors = [mesh.colors for mesh in meshes if mesh.colors is not None]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes])[first],
        np.concatenate(triangles).astype(np.int32),
        np.concatenate(colors)[first] if colors else None,
    )
