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
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.surface.codes import MESH_FILE_DAMAGED
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.pieces import Extent, Part

# Candidate planes for halving, as quantiles of the triangles' centres.
_SHARES = np.linspace(0.2, 0.8, 13)

Numbers = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Cut:
    """Subset of the triangles of a mesh.

    Attributes
    ----------
    mesh : these triangles and their vertices.
    numbers : (n,) int64, global index of each vertex.
    is_of_both : (n,) bool, vertices shared with other subsets.
    """

    mesh: Mesh
    numbers: Numbers
    is_of_both: Mask

    def lock(self) -> Mask:
        """Return a mask (n,) of shared vertices and their neighbours."""
        near, triangles = self.is_of_both.copy(), self.mesh.triangles
        near[triangles[self.is_of_both[triangles].any(axis=1)]] = True
        return np.asarray(near)


def whole_cut(mesh: Mesh) -> Cut:
    """Create a subset that contains a complete mesh."""
    count = len(mesh.vertices)
    return Cut(mesh, np.arange(count), np.zeros(count, np.bool_))


def halves(part: Part, extent: Extent, rim: float) -> tuple[Cut, Cut]:
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
    if (mesh.triangles[~is_strip] >= part.own).any():
        raise StageError(
            MESH_FILE_DAMAGED,
            "chunks of the mesh share vertices farther from their faces than the voxel size allows",
            remedy="fuse again.",
        )
    all_of_it = Cut(mesh, part.numbers, np.zeros(len(near), np.bool_))
    inside, strip = cuts_of(all_of_it, [np.flatnonzero(~is_strip), np.flatnonzero(is_strip)])
    return inside, strip


def joined_cuts(cuts: Sequence[Cut]) -> Cut:
    """Join one or more subsets into one.

    Shared vertices stay marked as shared.
    """
    all_numbers = np.concatenate([cut.numbers for cut in cuts])
    numbers, first, place = np.unique(all_numbers, return_index=True, return_inverse=True)
    both = np.zeros(len(numbers), bool)
    np.logical_or.at(both, place, np.concatenate([cut.is_of_both for cut in cuts]))
    return Cut(_merged([cut.mesh for cut in cuts], first, place), numbers, both)


def split(cut: Cut, most: int) -> Iterator[Cut]:
    """Split a subset into subsets of at most `most` triangles.

    The splitting planes cross few triangles. The subsets are yielded one by one to limit memory.
    """
    mesh = cut.mesh
    if len(mesh.triangles) <= most:
        yield cut
        return
    corners = mesh.vertices.astype(np.float32)[mesh.triangles]
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    del corners
    blocks = list(_halved(lows, highs, np.arange(len(lows), dtype=np.int32), most))
    del lows, highs
    yield from cuts_of(cut, blocks)


def cuts_of(cut: Cut, groups: Sequence[NDArray[np.integer[Any]]]) -> Iterator[Cut]:
    """Split a subset by groups of triangles that partition it."""
    mesh = cut.mesh
    seen, is_of_both = np.zeros(len(mesh.vertices), np.bool_), cut.is_of_both.copy()
    for rows in groups:
        used = _used(mesh, rows)
        is_of_both |= used & seen
        seen |= used
    for rows in groups:
        used = _used(mesh, rows)
        place = np.cumsum(used, dtype=np.int32) - np.int32(1)
        colors = None if mesh.colors is None else mesh.colors[used]
        some = Mesh(mesh.vertices[used], place[mesh.triangles[rows]], colors)
        yield Cut(some, cut.numbers[used], is_of_both[used])


def _used(mesh: Mesh, rows: NDArray[np.integer[Any]]) -> Mask:
    """Return a mask (n,) of the vertices that some triangles use."""
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.triangles[rows]] = True
    return used


def _halved(
    lows: NDArray[np.float32], highs: NDArray[np.float32], rows: NDArray[np.int32], most: int
) -> Iterator[NDArray[np.int32]]:
    """Halve triangles recursively, by planes that cross few of them.

    A plane along a noisy floor would create borders everywhere.

    Parameters
    ----------
    lows, highs : (m, 3) bounding boxes of all triangles.
    rows : triangles to divide.
    most : maximum number of triangles per group.
    """
    if len(rows) <= most:
        yield rows
        return
    low, high = lows[rows], highs[rows]
    middles = (low + high) / 2
    planes = [(axis, at) for axis in range(3) for at in np.quantile(middles[:, axis], _SHARES)]
    crossed = np.array([np.count_nonzero((low[:, i] < at) & (high[:, i] > at)) for i, at in planes])
    # A plane with all triangles on one side does not divide them.
    crossed[[not 0 < np.count_nonzero(middles[:, i] < at) < len(rows) for i, at in planes]] = len(rows)
    axis, at = planes[int(crossed.argmin())]
    # Triangles whose centres coincide cannot be separated by a plane.
    is_first = np.arange(len(rows)) < len(rows) // 2
    before = is_first if crossed.min() == len(rows) else middles[:, axis] < at
    del low, high, middles
    yield from _halved(lows, highs, rows[before], most)
    yield from _halved(lows, highs, rows[~before], most)


def numbers_of(cut: Cut, light: Simplified[Any]) -> Numbers:
    """Return the global index of each shared vertex, −1 for others.

    Raises
    ------
    StageError
        If a shared vertex has moved, which would be a bug.
    """
    source = light.vertex_source
    stayed = cut.is_of_both[source]
    if not np.array_equal(light.mesh.vertices[stayed], cut.mesh.vertices[source[stayed]]):
        raise StageError(MACHINE_BUG, "a locked vertex has moved, which is a bug in scanloom.")
    return np.where(stayed, cut.numbers[source], -1)


def joined(found: Sequence[tuple[Mesh, Numbers]], count: int) -> Mesh:
    """Join meshes at vertices with equal global indices.

    Parameters
    ----------
    found : meshes, and the global index of each vertex, −1 for unshared vertices.
    count : number of global indices.
    """
    if not found:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    given = np.concatenate([numbers for _, numbers in found])
    # Unshared vertices get unique keys beyond the global indices.
    own = np.where(given < 0, count + np.arange(len(given)), given)
    _, first, place = np.unique(own, return_index=True, return_inverse=True)
    # Number vertices in order of first occurrence.
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    place, first = rank[place], first[order]
    return _merged([mesh for mesh, _ in found], first, place)


def _merged(meshes: Sequence[Mesh], first: NDArray[np.intp], place: NDArray[np.intp]) -> Mesh:
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
