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
from scanloom.stages.inspecting.coverage.depth_view import DepthView, Floats, Singles

# Flags of a cell: a frame looked through it; it is behind a measurement; a frame has no depth there; it
# contains a measurement; it contains surface.
_FREE_FLAG, _OCCLUDED_FLAG, _NO_DEPTH_FLAG, _MEASURED_FLAG, _SURFACE_FLAG = 1, 2, 4, 8, 16
# State of the space behind a frontier.
UNSEEN, NO_DEPTH, OCCLUDED = 0, 1, 2
# Side of a block in cells. Blocks outside an image are skipped as a whole.
_BLOCK_CELLS = 16
# Maximum number of cells.
_MAX_CELLS = 1_500_000
# Margin around the surface, in cells.
_MARGIN_CELLS = 3
# Safety margin in front of a measurement in which space is not marked as free: cells, and ratio of the depth.
_FRONT_MARGIN_CELLS, _FRONT_MARGIN_RATIO = 1.0, np.float32(0.01)


@dataclass(frozen=True, eq=False)
class Frontier:
    """Faces between free and unknown cells.

    Attributes
    ----------
    points : (k, 3) float64, face centres relative to the origin, metres.
    normals : (k, 3) float64, towards free space.
    state_behind : (k,) int8, state of the unknown cell. `OCCLUDED`: behind a measurement of some frame.
        `NO_DEPTH`:
        frames that looked there have no depth. `UNSEEN`: no frame looked there.
    component_labels : (k,) int64, label of the connected component; `state_behind` is constant in a
        component.
    is_near_surface : (k,) bool, True close to the surface.
    neighbour_counts : (k,) number of frontier cells among the 27 cells around the cell: 3 along a line, 9 in
        a plane.
    face_area : area of a face, m².
    """

    points: Floats
    normals: Floats
    state_behind: NDArray[np.int8]
    component_labels: NDArray[np.int64]
    is_near_surface: NDArray[np.bool_]
    neighbour_counts: NDArray[np.int64]
    face_area: float


class CarvedSpace:
    """Grid of the observed space around a surface.

    Parameters
    ----------
    box : (2, 3) minimum and maximum corner of the surface relative to the origin, metres.
    samples : batches of surface points (k, 3), spaced more closely than the cells.
    cell_size : cell size in metres; enlarged if the grid would have too many cells.
    """

    def __init__(self, box: Floats, samples: Iterable[Floats], cell_size: float) -> None:
        low, high = box
        self.cell_size = max(cell_size, _compute_cell_size(high - low))
        self._min_corner = low - _MARGIN_CELLS * self.cell_size
        self._shape = np.ceil((high - self._min_corner) / self.cell_size).astype(np.int64) + _MARGIN_CELLS
        self._state = np.zeros(int(self._shape.prod()), np.uint8)
        for some in samples:
            numbers, _ = self._find_cells(some)
            self._state[numbers] |= _SURFACE_FLAG
        self._block_centers, self._block_cells, self._block_cell_centers = self._group_into_blocks()

    def add_view(self, view: DepthView) -> None:
        """Carve the space that a frame looked through, and mark its measurements."""
        self._update_free_space(view)
        rows, columns = np.nonzero(view.coarse_depth)
        z = view.coarse_depth[rows, columns]
        middle = (view.downsampling - 1) / 2
        measured = unproject(
            columns * view.downsampling + middle, rows * view.downsampling + middle, z, view.camera
        )
        numbers, _ = self._find_cells(
            (measured - view.translation).astype(np.float64) @ view.rotation.astype(np.float64)
        )
        self._state[numbers] |= _MEASURED_FLAG

    def is_free(self, points: Floats) -> NDArray[np.bool_]:
        """Return a mask (k,) of the points that some frame looked through.

        Points outside the grid are False.
        """
        return self._has_flags(points, _FREE_FLAG)

    def classify_points(self, points: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return masks (k,) of the points in unknown and in free cells."""
        known = _FREE_FLAG | _OCCLUDED_FLAG | _MEASURED_FLAG | _SURFACE_FLAG
        return self.is_inside(points) & ~self._has_flags(points, known), self._has_flags(points, _FREE_FLAG)

    def is_inside(self, points: Floats) -> NDArray[np.bool_]:
        """Return a mask (k,) of the points inside the grid."""
        inside = np.zeros(len(points), bool)
        inside[self._find_cells(points)[1]] = True
        return inside

    def find_frontier(self) -> Frontier:
        """Find the faces where free space ends at unknown space."""
        from scipy.ndimage import binary_dilation, convolve, label

        state = self._state.reshape(self._shape)
        surface = (state & _SURFACE_FLAG) > 0
        free = ((state & _FREE_FLAG) > 0) & ~surface
        unknown = ~free & ((state & (_SURFACE_FLAG | _MEASURED_FLAG)) == 0)
        found: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
        for axis in range(3):
            for sign in (1, -1):
                # Require two cells on each side; thinner layers are staircase artefacts of the grid.
                is_face = free & _shift_grid(free, axis, -sign)
                is_face &= _shift_grid(unknown, axis, sign) & _shift_grid(unknown, axis, 2 * sign)
                cells = np.argwhere(is_face)
                found.append((cells, np.tile(sign * np.eye(3, dtype=np.int64)[axis], (len(cells), 1))))
        cells, steps = (np.concatenate(rows) for rows in zip(*found, strict=True))
        beyond = state[tuple((cells + steps).T)]
        behind = np.where(
            beyond & _OCCLUDED_FLAG, OCCLUDED, np.where(beyond & _NO_DEPTH_FLAG, NO_DEPTH, UNSEEN)
        )
        parts, beside, count = np.zeros(len(cells), np.int64), np.zeros(len(cells), np.int64), 0
        for chosen in (behind == kind for kind in (UNSEEN, NO_DEPTH, OCCLUDED)):
            is_frontier = np.zeros(state.shape, bool)
            at = tuple(cells[chosen].T)
            is_frontier[at] = True
            labels, more = label(is_frontier, np.ones((3, 3, 3)))
            parts[chosen] = count + labels[at]
            beside[chosen] = convolve(is_frontier.astype(np.int8), np.ones((3, 3, 3), np.int8))[at]
            count += more
        near = binary_dilation(surface, np.ones((3, 3, 3)), iterations=2)
        return Frontier(
            points=self._min_corner + (cells + 0.5 + 0.5 * steps) * self.cell_size,
            normals=-steps.astype(np.float64),
            state_behind=behind.astype(np.int8),
            component_labels=parts,
            is_near_surface=near[tuple(cells.T)],
            neighbour_counts=beside,
            face_area=self.cell_size**2,
        )

    def _has_flags(self, points: Floats, flags: int) -> NDArray[np.bool_]:
        numbers, inside = self._find_cells(points)
        found = np.zeros(len(points), bool)
        found[inside] = (self._state[numbers] & flags) > 0
        return found

    def _find_cells(self, points: Floats) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        """Find the grid cells of points.

        Returns
        -------
        The flat cell indices of the points inside the grid, and the rows of these points.
        """
        cells = np.floor((points - self._min_corner) / self.cell_size).astype(np.int64)
        (inside,) = np.nonzero(((cells >= 0) & (cells < self._shape)).all(axis=1))
        return np.ravel_multi_index(tuple(cells[inside].T), tuple(self._shape)), inside

    def _group_into_blocks(self) -> tuple[Singles, list[NDArray[np.int64]], list[Singles]]:
        """Group the cells without surface into blocks.

        Returns
        -------
        Block centres (b, 3), and per block the flat cell indices and cell centres, relative to the origin.
        """
        (ids,) = np.nonzero(self._state == 0)
        cells = np.stack(np.unravel_index(ids, tuple(self._shape)), axis=1)
        blocks = -(-self._shape // _BLOCK_CELLS)
        keys = np.ravel_multi_index(tuple((cells // _BLOCK_CELLS).T), tuple(blocks))
        order = np.argsort(keys, kind="stable")
        present, starts = np.unique(keys[order], return_index=True)
        centers = (self._min_corner + (cells[order] + 0.5) * self.cell_size).astype(np.float32)
        places = np.stack(np.unravel_index(present, tuple(blocks)), axis=1)
        middles = (self._min_corner + (places + 0.5) * _BLOCK_CELLS * self.cell_size).astype(np.float32)
        return middles, np.split(ids[order], starts[1:]), np.split(centers, starts[1:])

    def _update_free_space(self, view: DepthView) -> None:
        visible_blocks = [block for block in self._find_visible_blocks(view) if len(self._block_cells[block])]
        if not visible_blocks:
            return
        ids = np.concatenate([self._block_cells[block] for block in visible_blocks])
        columns, rows, z = view.project_points(
            np.concatenate([self._block_cell_centers[block] for block in visible_blocks])
        )
        inside, pixels = view.find_pixels(columns, rows, z, view.downsampling)
        depth = view.filled_depth.reshape(-1)[pixels]
        is_free = np.zeros(len(ids), bool)
        is_free[inside] = z[inside] < depth * (1 - _FRONT_MARGIN_RATIO) - np.float32(
            _FRONT_MARGIN_CELLS * self.cell_size
        )
        self._state[ids[inside[depth > 0]]] |= _OCCLUDED_FLAG
        self._state[ids[inside[depth == 0]]] |= _NO_DEPTH_FLAG
        self._state[ids[is_free]] |= _FREE_FLAG
        ends = np.cumsum([len(self._block_cells[block]) for block in visible_blocks])
        for block, kept in zip(visible_blocks, np.split(~is_free, ends[:-1]), strict=True):
            if not kept.all():
                self._block_cells[block], self._block_cell_centers[block] = (
                    self._block_cells[block][kept],
                    self._block_cell_centers[block][kept],
                )

    def _find_visible_blocks(self, view: DepthView) -> list[int]:
        """Return the blocks that may be inside a view frustum."""
        camera = view.camera
        radius = np.float32(0.5 * 3**0.5 * _BLOCK_CELLS * self.cell_size)
        x, y, z = view.rotation @ self._block_centers.T + view.translation[:, None]
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


def _compute_cell_size(extent: Floats) -> float:
    """Find the smallest cell size that keeps the grid within `_MAX_CELLS` cells."""
    low, high = 0.0, float(max(extent.max(), 1e-9))
    for _ in range(40):
        middle = (low + high) / 2
        if np.prod(extent / middle + 2 * _MARGIN_CELLS + 1) > _MAX_CELLS:
            low = middle
        else:
            high = middle
    return high


def _shift_grid(cells: NDArray[np.bool_], axis: int, offset: int) -> NDArray[np.bool_]:
    """Shift a boolean grid by `offset` cells towards its start.

    Cells beyond the grid become False.
    """
    result = np.zeros_like(cells)
    to, of = [slice(None)] * 3, [slice(None)] * 3
    to[axis] = slice(0, -offset) if offset > 0 else slice(-offset, None)
    of[axis] = slice(offset, None) if offset > 0 else slice(0, offset)
    result[tuple(to)] = cells[tuple(of)]
    return result
