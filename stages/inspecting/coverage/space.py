"""Space carving around a surface: free, occluded and unobserved cells, and frontiers.

Every cell of the grid is unknown until a frame looks through its centre. Missing surface shows as a frontier:
free space next to unknown space without a surface between them. The space behind a frontier was occluded in
all frames, had no depth, or was never in an image.

References
----------
Curless and Levoy, A Volumetric Method for Building Complex Models from Range Images, 1996 (holes are where
empty meets unseen); Yamauchi, A Frontier-Based Approach for Autonomous Exploration, 1997.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.projection import unproject
from scanloom.stages.inspecting.coverage.views import Floats, Singles, View

# Flags of a cell: a frame looked through it; it is behind a measurement; a frame has no depth there; it
# contains a measurement; it contains surface.
_FREE, _HIDDEN, _BLANK, _MEASURED, _SURFACE = 1, 2, 4, 8, 16
# State of the space behind a frontier.
NOTHING, BLANK, HIDDEN = 0, 1, 2
# Side of a block in cells. Blocks outside an image are skipped as a whole.
_BLOCK = 16
# Maximum number of cells.
_CELLS = 1_500_000
# Margin around the surface, in cells.
_AROUND = 3
# Safety margin in front of a measurement in which space is not marked as free: cells, and ratio of the depth.
_BEFORE_CELLS, _BEFORE_DEPTH = 1.0, np.float32(0.01)


@dataclass(frozen=True, eq=False)
class Frontier:
    """Faces between free and unknown cells.

    Attributes
    ----------
    points : (k, 3) float64, face centres relative to the origin, metres.
    normals : (k, 3) float64, towards free space.
    behind : (k,) int8, state of the unknown cell. `HIDDEN`: behind a measurement of some frame. `BLANK`:
        frames that looked there have no depth. `NOTHING`: no frame looked there.
    parts : (k,) int64, label of the connected component; `behind` is constant in a component.
    at_rim : (k,) bool, True close to the surface.
    beside : (k,) number of frontier cells among the 27 cells around the cell: 3 along a line, 9 in a plane.
    face : area of a face, m².
    """

    points: Floats
    normals: Floats
    behind: NDArray[np.int8]
    parts: NDArray[np.int64]
    at_rim: NDArray[np.bool_]
    beside: NDArray[np.int64]
    face: float


class Space:
    """Grid of the observed space around a surface.

    Parameters
    ----------
    box : (2, 3) minimum and maximum corner of the surface relative to the origin, metres.
    samples : batches of surface points (k, 3), spaced more closely than the cells.
    cell : cell size in metres; enlarged if the grid would have too many cells.
    """

    def __init__(self, box: Floats, samples: Iterable[Floats], cell: float) -> None:
        low, high = box
        self.cell = max(cell, _cell_for(high - low))
        self._low = low - _AROUND * self.cell
        self._shape = np.ceil((high - self._low) / self.cell).astype(np.int64) + _AROUND
        self._state = np.zeros(int(self._shape.prod()), np.uint8)
        for some in samples:
            numbers, _ = self._numbers(some)
            self._state[numbers] |= _SURFACE
        self._blocks, self._ids, self._centers = self._in_blocks()

    def see(self, view: View) -> None:
        """Carve the space that a frame looked through, and mark its measurements."""
        self._carve(view)
        rows, columns = np.nonzero(view.coarse)
        z = view.coarse[rows, columns]
        middle = (view.step - 1) / 2
        seen = unproject(columns * view.step + middle, rows * view.step + middle, z, view.camera)
        numbers, _ = self._numbers((seen - view.shift).astype(np.float64) @ view.turn.astype(np.float64))
        self._state[numbers] |= _MEASURED

    def is_free(self, points: Floats) -> NDArray[np.bool_]:
        """Return a mask (k,) of the points that some frame looked through.

        Points outside the grid are False.
        """
        return self._has(points, _FREE)

    def unknown_and_free(self, points: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return masks (k,) of the points in unknown and in free cells."""
        known = _FREE | _HIDDEN | _MEASURED | _SURFACE
        return self.is_inside(points) & ~self._has(points, known), self._has(points, _FREE)

    def is_inside(self, points: Floats) -> NDArray[np.bool_]:
        """Return a mask (k,) of the points inside the grid."""
        inside = np.zeros(len(points), bool)
        inside[self._numbers(points)[1]] = True
        return inside

    def frontier(self) -> Frontier:
        """Find the faces where free space ends at unknown space."""
        from scipy.ndimage import binary_dilation, convolve, label

        state = self._state.reshape(self._shape)
        surface = (state & _SURFACE) > 0
        free = ((state & _FREE) > 0) & ~surface
        unknown = ~free & ((state & (_SURFACE | _MEASURED)) == 0)
        found: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
        for axis in range(3):
            for sign in (1, -1):
                # Require two cells on each side; thinner layers are staircase artefacts of the grid.
                is_face = free & _shifted(free, axis, -sign)
                is_face &= _shifted(unknown, axis, sign) & _shifted(unknown, axis, 2 * sign)
                cells = np.argwhere(is_face)
                found.append((cells, np.tile(sign * np.eye(3, dtype=np.int64)[axis], (len(cells), 1))))
        cells, steps = (np.concatenate(rows) for rows in zip(*found, strict=True))
        beyond = state[tuple((cells + steps).T)]
        behind = np.where(beyond & _HIDDEN, HIDDEN, np.where(beyond & _BLANK, BLANK, NOTHING))
        parts, beside, count = np.zeros(len(cells), np.int64), np.zeros(len(cells), np.int64), 0
        for chosen in (behind == kind for kind in (NOTHING, BLANK, HIDDEN)):
            is_frontier = np.zeros(state.shape, bool)
            at = tuple(cells[chosen].T)
            is_frontier[at] = True
            labels, more = label(is_frontier, np.ones((3, 3, 3)))
            parts[chosen] = count + labels[at]
            beside[chosen] = convolve(is_frontier.astype(np.int8), np.ones((3, 3, 3), np.int8))[at]
            count += more
        near = binary_dilation(surface, np.ones((3, 3, 3)), iterations=2)
        return Frontier(
            points=self._low + (cells + 0.5 + 0.5 * steps) * self.cell,
            normals=-steps.astype(np.float64),
            behind=behind.astype(np.int8),
            parts=parts,
            at_rim=near[tuple(cells.T)],
            beside=beside,
            face=self.cell**2,
        )

    def _has(self, points: Floats, flags: int) -> NDArray[np.bool_]:
        numbers, inside = self._numbers(points)
        found = np.zeros(len(points), bool)
        found[inside] = (self._state[numbers] & flags) > 0
        return found

    def _numbers(self, points: Floats) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        """Find the grid cells of points.

        Returns
        -------
        The flat cell indices of the points inside the grid, and the rows of these points.
        """
        cells = np.floor((points - self._low) / self.cell).astype(np.int64)
        (inside,) = np.nonzero(((cells >= 0) & (cells < self._shape)).all(axis=1))
        return np.ravel_multi_index(tuple(cells[inside].T), tuple(self._shape)), inside

    def _in_blocks(self) -> tuple[Singles, list[NDArray[np.int64]], list[Singles]]:
        """Group the cells without surface into blocks.

        Returns
        -------
        Block centres (b, 3), and per block the flat cell indices and cell centres, relative to the origin.
        """
        (ids,) = np.nonzero(self._state == 0)
        cells = np.stack(np.unravel_index(ids, tuple(self._shape)), axis=1)
        blocks = -(-self._shape // _BLOCK)
        keys = np.ravel_multi_index(tuple((cells // _BLOCK).T), tuple(blocks))
        order = np.argsort(keys, kind="stable")
        present, starts = np.unique(keys[order], return_index=True)
        centers = (self._low + (cells[order] + 0.5) * self.cell).astype(np.float32)
        places = np.stack(np.unravel_index(present, tuple(blocks)), axis=1)
        middles = (self._low + (places + 0.5) * _BLOCK * self.cell).astype(np.float32)
        return middles, np.split(ids[order], starts[1:]), np.split(centers, starts[1:])

    def _carve(self, view: View) -> None:
        shown = [block for block in self._shown(view) if len(self._ids[block])]
        if not shown:
            return
        ids = np.concatenate([self._ids[block] for block in shown])
        columns, rows, z = view.in_camera(np.concatenate([self._centers[block] for block in shown]))
        inside, pixels = view.pixels(columns, rows, z, view.step)
        depth = view.filled.reshape(-1)[pixels]
        is_free = np.zeros(len(ids), bool)
        is_free[inside] = z[inside] < depth * (1 - _BEFORE_DEPTH) - np.float32(_BEFORE_CELLS * self.cell)
        self._state[ids[inside[depth > 0]]] |= _HIDDEN
        self._state[ids[inside[depth == 0]]] |= _BLANK
        self._state[ids[is_free]] |= _FREE
        ends = np.cumsum([len(self._ids[block]) for block in shown])
        for block, kept in zip(shown, np.split(~is_free, ends[:-1]), strict=True):
            if not kept.all():
                self._ids[block], self._centers[block] = self._ids[block][kept], self._centers[block][kept]

    def _shown(self, view: View) -> list[int]:
        """Return the blocks that may be inside a view frustum."""
        camera = view.camera
        radius = np.float32(0.5 * 3**0.5 * _BLOCK * self.cell)
        x, y, z = view.turn @ self._blocks.T + view.shift[:, None]
        shown = z > -radius
        # Signed distances to the four side planes of the frustum.
        for across, focal, center, size in (
            (x, camera.fx, camera.cx, camera.width),
            (y, camera.fy, camera.cy, camera.height),
        ):
            for edge, sign in ((-0.5 - center, 1.0), (size - 0.5 - center, -1.0)):
                length = (focal**2 + edge**2) ** 0.5
                shown &= sign * (focal * across - edge * z) / length > -radius
        return [int(block) for block in np.flatnonzero(shown)]


def _cell_for(size: Floats) -> float:
    """Find the smallest cell size that keeps the grid within `_CELLS` cells."""
    low, high = 0.0, float(max(size.max(), 1e-9))
    for _ in range(40):
        middle = (low + high) / 2
        if np.prod(size / middle + 2 * _AROUND + 1) > _CELLS:
            low = middle
        else:
            high = middle
    return high


def _shifted(cells: NDArray[np.bool_], axis: int, by: int) -> NDArray[np.bool_]:
    """Shift a boolean grid by `by` cells towards its start.

    Cells beyond the grid become False.
    """
    result = np.zeros_like(cells)
    to, of = [slice(None)] * 3, [slice(None)] * 3
    to[axis] = slice(0, -by) if by > 0 else slice(-by, None)
    of[axis] = slice(by, None) if by > 0 else slice(0, by)
    result[tuple(to)] = cells[tuple(of)]
    return result
