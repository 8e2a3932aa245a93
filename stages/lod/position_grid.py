"""Common position grid of all tiles, with a power-of-two step.

Separate grids would open cracks between tiles. On a common grid, a vertex shared by two tiles has identical
coordinates in both. With a power of two, no digits are lost in single precision.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.lod.codes import LEVELS_TILES_TOO_FINE
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.surface.welding import find_first_equal_rows

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

# Search radii for a free grid point if the nearest one is occupied, in steps along each axis.
_SEARCH_RADII = (1, 2, 4)
_MAX_SEARCH_RADIUS = _SEARCH_RADII[-1]
# Maximum extent of the model in steps, without the search margin, for 16 bits and for single precision.
_MAX_STEPS_16_BITS = 2**16 - 1 - 2 * _MAX_SEARCH_RADIUS
_MAX_STEPS_SINGLE = 2**21 - 1 - 2 * _MAX_SEARCH_RADIUS
# Maximum step relative to the bound of the finest level.
_STEP_PER_BOUND = 0.25
# A model farther from the origin than this multiple of its size is moved there, to keep its precision.
_FAR_RATIO = 4.0
# Range of steps whose multiples are exact in single precision.
_MIN_STEP, _MAX_STEP = 2.0**-100, 2.0**100


@dataclass(frozen=True, eq=False)
class PositionGrid:
    """Grid of positions: integer multiples of a step from an origin.

    Attributes
    ----------
    step : metres, a power of two.
    origin : (3,) float64, metres; 0 unless the model is far from the origin.
    in_16_bits : positions are stored as 16-bit steps; otherwise in single precision.
    max_displacement_m : maximum displacement of positions, and so of surface points, metres.
    """

    step: float
    origin: Floats
    in_16_bits: bool
    max_displacement_m: float


def snap_to_grid(hierarchy: Hierarchy) -> tuple[Hierarchy, PositionGrid]:
    """Snap all positions of a hierarchy to a common grid.

    The step is as fine as 16 bits allow for the whole model. If it is coarser than a quarter of the finest
    level's bound, or too coarse to separate the vertices, single precision is used, with 32 times finer
    steps.

    Distinct vertices stay distinct: if two have the same nearest grid point, the second takes a free one
    nearby. Therefore no triangle degenerates, and adjacent meshes stay adjacent.

    Returns
    -------
    The hierarchy with positions relative to the grid's origin, and the grid.

    Raises
    ------
    InputError
        If the model is too large for single precision, or vertices are too dense for the grid.
    """
    low, high = hierarchy.vertices.min(axis=0), hierarchy.vertices.max(axis=0)
    size, center = float((high - low).max()), 0.5 * (low + high)
    max_step = _STEP_PER_BOUND * _find_finest_bound(hierarchy)
    for steps, in_16_bits in ((_MAX_STEPS_16_BITS, True), (_MAX_STEPS_SINGLE, False)):
        step = _choose_step(size, steps)
        if step > _MAX_STEP:
            raise InputError(
                LEVELS_TILES_TOO_FINE,
                "the model is too large for tiles, which store positions in single precision.",
            )
        if in_16_bits and step > max_step:
            continue
        is_far = float(np.abs(center).max()) > _FAR_RATIO * size
        origin = np.rint(center / step) * step if is_far else np.zeros(3)
        exact = (hierarchy.vertices - origin) / step
        grid_points = _assign_grid_points(exact)
        if grid_points is None:
            continue
        max_offset = float(np.sqrt(((grid_points - exact) ** 2).sum(axis=1)).max())
        # Rounded up by more than the floating-point error of the lines above.
        rounding_error = 4 * float(np.spacing(np.abs(center).max() + size))
        displacement = max(math.sqrt(3) / 2, max_offset) * step * (1 + 1e-9) + rounding_error
        return replace(hierarchy, vertices=grid_points * step), PositionGrid(
            step, origin, in_16_bits, displacement
        )
    raise InputError(
        LEVELS_TILES_TOO_FINE,
        (
            "vertices are too close to each other for tiles, which store positions in single precision; "
            "build the levels with a larger base_error."
        ),
    )


def _choose_step(size: float, steps: int) -> float:
    """Return the smallest power of two of which at most `steps` cover a length.

    Infinite if no float is large enough.
    """
    if not size / steps < 2.0**1000:
        return math.inf
    step = 2.0 ** (math.frexp(max(size, _MIN_STEP) / steps)[1] - 1)
    return max(step if step * steps >= size else 2 * step, _MIN_STEP)


def _find_finest_bound(h: Hierarchy) -> float:
    """Return the largest bound of the finest level with a positive bound, else infinity."""
    of_levels = [float(h.shape_bound[h.level == level].max()) for level in np.unique(h.level)]
    return min((bound for bound in [h.base_shape_bound, *of_levels] if bound > 0), default=math.inf)


def _assign_grid_points(exact: Floats) -> Floats | None:
    """Assign a grid point (n, 3) to each position, both in steps.

    Returns None if the positions are too dense. Equal positions get the same grid point, different positions
    different ones.
    """
    grid_points = np.rint(exact)
    same = find_first_equal_rows(list(exact.T))
    representatives = np.flatnonzero(same == np.arange(len(same)))
    low = grid_points.min(axis=0) - _MAX_SEARCH_RADIUS
    key = _pack_keys(grid_points - low)
    found, owner = np.unique(key[representatives], return_index=True)
    is_owner = np.zeros(len(representatives), bool)
    is_owner[owner] = True
    occupied: set[int] = set()
    for vertex in representatives[~is_owner]:
        for radius in _SEARCH_RADII:
            near = grid_points[vertex] + _list_offsets(radius)
            near_keys = _pack_keys(near - low)
            at = np.searchsorted(found, near_keys).clip(max=len(found) - 1)
            free = [i for i in np.flatnonzero(found[at] != near_keys) if int(near_keys[i]) not in occupied]
            if free:
                break
        else:
            return None
        squared_offsets = ((near[free] - exact[vertex]) ** 2).sum(axis=1)
        best = free[int(np.argmin(squared_offsets))]
        grid_points[vertex] = near[best]
        occupied.add(int(near_keys[best]))
    return np.asarray(grid_points[same] + 0.0)  # turn -0.0 into 0.0


@cache
def _list_offsets(radius: int) -> Floats:
    """Return the offsets (k, 3) of all grid points within `radius` steps along each axis."""
    return np.array(list(itertools.product(range(-radius, radius + 1), repeat=3)), np.float64)


def _pack_keys(points: Floats) -> Ids:
    """Pack grid coordinates, 21 bits each, into one integer key."""
    x, y, z = points.astype(np.int64).T
    return np.asarray((z << 42) | (y << 21) | x)
