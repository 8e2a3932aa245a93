"""Parts of a mesh that are simplified each by itself, and fit each other afterwards.

A cut knows which of its vertices others name, too, and what number each has in all; joined again, cuts whose
such vertices stayed where they were are one mesh without a crack.
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

# Where a part may be divided, as shares of its triangles.
_SHARES = np.linspace(0.2, 0.8, 13)

Numbers = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Cut:
    """Some triangles of a mesh.

    Attributes
    ----------
    mesh : them alone.
    numbers : (n,) of its vertices in all.
    is_of_both : (n,) which of them others name, too.
    """

    mesh: Mesh
    numbers: Numbers
    is_of_both: Mask

    def lock(self) -> Mask:
        """Return which vertices (n,) are to stay: those that others name, and their neighbours."""
        near, triangles = self.is_of_both.copy(), self.mesh.triangles
        near[triangles[self.is_of_both[triangles].any(axis=1)]] = True
        return np.asarray(near)


def whole_cut(mesh: Mesh) -> Cut:
    """Return all of a mesh."""
    count = len(mesh.vertices)
    return Cut(mesh, np.arange(count), np.zeros(count, np.bool_))


def halves(part: Part, extent: Extent, rim: float) -> tuple[Cut, Cut]:
    """Cut a piece in its inside and the strip along its faces."""
    mesh = part.mesh
    low, high = np.array(extent.low) + rim, np.array(extent.high) - rim
    near = np.asarray(((mesh.vertices < low) | (mesh.vertices > high)).any(axis=1), np.bool_)
    is_strip = np.asarray(near[mesh.triangles].all(axis=1))
    if (mesh.triangles[~is_strip] >= part.own).any():
        raise StageError(
            MESH_FILE_DAMAGED,
            "pieces of the mesh meet farther inside than their voxels tell",
            remedy="fuse again.",
        )
    all_of_it = Cut(mesh, part.numbers, np.zeros(len(near), np.bool_))
    inside, strip = cuts_of(all_of_it, [np.flatnonzero(~is_strip), np.flatnonzero(is_strip)])
    return inside, strip


def joined_cuts(cuts: Sequence[Cut]) -> Cut:
    """Make one of some cuts, one at least."""
    all_numbers = np.concatenate([cut.numbers for cut in cuts])
    numbers, first, place = np.unique(all_numbers, return_index=True, return_inverse=True)
    both = np.zeros(len(numbers), bool)
    np.logical_or.at(both, place, np.concatenate([cut.is_of_both for cut in cuts]))
    return Cut(_merged([cut.mesh for cut in cuts], first, place), numbers, both)


def split(cut: Cut, most: int) -> Iterator[Cut]:
    """Yield a cut in parts of at most so many triangles, one by one, divided where few of them are."""
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
    """Yield the triangles of each group, which have all of a cut's, one after the other."""
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
    """Return which vertices (n,) some triangles have."""
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.triangles[rows]] = True
    return used


def _halved(
    lows: NDArray[np.float32], highs: NDArray[np.float32], rows: NDArray[np.int32], most: int
) -> Iterator[NDArray[np.int32]]:
    """Yield the rows of some triangles, (m, 3) lows to highs, divided by planes that few of them cross.

    What is divided along a floor, through its noise, would have nothing but borders there.
    """
    if len(rows) <= most:
        yield rows
        return
    low, high = lows[rows], highs[rows]
    middles = (low + high) / 2
    planes = [(axis, at) for axis in range(3) for at in np.quantile(middles[:, axis], _SHARES)]
    crossed = np.array([np.count_nonzero((low[:, i] < at) & (high[:, i] > at)) for i, at in planes])
    # A plane beside all of them divides nothing.
    crossed[[not 0 < np.count_nonzero(middles[:, i] < at) < len(rows) for i, at in planes]] = len(rows)
    axis, at = planes[int(crossed.argmin())]
    # Of many in one place by their numbers.
    is_first = np.arange(len(rows)) < len(rows) // 2
    before = is_first if crossed.min() == len(rows) else middles[:, axis] < at
    del low, high, middles
    yield from _halved(lows, highs, rows[before], most)
    yield from _halved(lows, highs, rows[~before], most)


def numbers_of(cut: Cut, light: Simplified[Any]) -> Numbers:
    """Return the numbers in all of the vertices that stayed because others name them, −1 for all else."""
    source = light.vertex_source
    stayed = cut.is_of_both[source]
    if not np.array_equal(light.mesh.vertices[stayed], cut.mesh.vertices[source[stayed]]):
        raise StageError(
            MACHINE_BUG, "a vertex that was to stay has moved, which is a defect of this program."
        )
    return np.where(stayed, cut.numbers[source], -1)


def joined(found: Sequence[tuple[Mesh, Numbers]], count: int) -> Mesh:
    """Join meshes at the vertices that have a number in all, below `count`."""
    if not found:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    given = np.concatenate([numbers for _, numbers in found])
    # A vertex without one is its own.
    own = np.where(given < 0, count + np.arange(len(given)), given)
    _, first, place = np.unique(own, return_index=True, return_inverse=True)
    # In the order in which they come.
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    place, first = rank[place], first[order]
    return _merged([mesh for mesh, _ in found], first, place)


def _merged(meshes: Sequence[Mesh], first: NDArray[np.intp], place: NDArray[np.intp]) -> Mesh:
    """Make one of some meshes.

    Parameters
    ----------
    first : of each of its vertices, where it is first among those of all meshes, one mesh after the other.
    place : of each of these, which vertex it is.
    """
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    triangles = [place[mesh.triangles + start] for mesh, start in zip(meshes, offsets, strict=True)]
    colors = [mesh.colors for mesh in meshes if mesh.colors is not None]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes])[first],
        np.concatenate(triangles).astype(np.int32),
        np.concatenate(colors)[first] if colors else None,
    )
