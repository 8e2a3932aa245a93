"""One grid for the positions of all tiles, with a step that is a power of two.

A grid for each tile would tear tiles apart along their borders. On one grid, a vertex that two tiles share
has the same numbers in both, and a power of two loses none of them in single precision.
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
from scanloom.stages.surface.welding import same_rows

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

# Where a place of the grid is taken, one so many steps away along each axis is looked for.
_REACHES = (1, 2, 4)
_FARTHEST = _REACHES[-1]
# Steps that the whole model may span, with room around it: in 16 bits, and in single precision.
_IN_16_BITS = 2**16 - 1 - 2 * _FARTHEST
_IN_SINGLE = 2**21 - 1 - 2 * _FARTHEST
# A step is at most this share of the finest level's bound.
_STEP_PER_BOUND = 0.25
# A model this many times its size away from the origin is moved there, which keeps its digits.
_FAR = 4.0
# Steps beyond these have no exact multiples in single precision.
_LEAST, _LARGEST = 2.0**-100, 2.0**100


@dataclass(frozen=True, eq=False)
class Grid:
    """Where positions may lie: at whole multiples of the step from the origin.

    Attributes
    ----------
    step : metres, a power of two.
    origin : (3,) float64, metres; 0 unless the model is far from it.
    in_16_bits : whether positions are written as steps in 16 bits; else in single precision.
    share_m : no position, and so no point of a surface, was moved farther than this, metres.
    """

    step: float
    origin: Floats
    in_16_bits: bool
    share_m: float


def on_grid(hierarchy: Hierarchy) -> tuple[Hierarchy, Grid]:
    """Return a hierarchy with all positions on one grid, told from its origin, and the grid.

    Steps are as fine as 16 bits allow for the whole model. Where that is coarser than a quarter of the finest
    level's bound, or too coarse for the vertices, positions take single precision, and steps are 32 times
    finer.

    Vertices of different places stay apart: where two are nearest to the same place of the grid, the second
    takes one beside it that is free. So no triangle loses a corner, and what fits together before does after.

    Raises
    ------
    InputError
        If the model is too large for single precision, or vertices crowd so close that no place is free.
    """
    low, high = hierarchy.vertices.min(axis=0), hierarchy.vertices.max(axis=0)
    size, middle = float((high - low).max()), 0.5 * (low + high)
    wanted = _STEP_PER_BOUND * _finest_bound(hierarchy)
    for steps, in_16_bits in ((_IN_16_BITS, True), (_IN_SINGLE, False)):
        step = _step_for(size, steps)
        if step > _LARGEST:
            raise InputError(
                LEVELS_TILES_TOO_FINE,
                "the model is too large for tiles, whose positions have single precision.",
            )
        if in_16_bits and step > wanted:
            continue
        is_far = float(np.abs(middle).max()) > _FAR * size
        origin = np.rint(middle / step) * step if is_far else np.zeros(3)
        exact = (hierarchy.vertices - origin) / step
        places = _places(exact)
        if places is None:
            continue
        moved = float(np.sqrt(((places - exact) ** 2).sum(axis=1)).max())
        # Rounded up beyond what the lines above may have lost.
        lost = 4 * float(np.spacing(np.abs(middle).max() + size))
        share = max(math.sqrt(3) / 2, moved) * step * (1 + 1e-9) + lost
        return replace(hierarchy, vertices=places * step), Grid(step, origin, in_16_bits, share)
    raise InputError(
        LEVELS_TILES_TOO_FINE,
        (
            "vertices crowd too close for tiles, whose positions have single precision; "
            "build the levels with a larger base_error."
        ),
    )


def _step_for(size: float, steps: int) -> float:
    """Return the least power of two of which a length has no more than so many."""
    step = 2.0 ** (math.frexp(max(size, _LEAST) / steps)[1] - 1)
    return max(step if step * steps >= size else 2 * step, _LEAST)


def _finest_bound(h: Hierarchy) -> float:
    """Return the largest bound of the finest level that has one; infinite if none has."""
    of_levels = [float(h.shape_bound[h.level == level].max()) for level in np.unique(h.level)]
    return min((bound for bound in [h.base_shape_bound, *of_levels] if bound > 0), default=math.inf)


def _places(exact: Floats) -> Floats | None:
    """Return a place of the grid, whole numbers (n, 3), for each position in steps; None if they crowd.

    The same place for the same position, and another for any other.
    """
    places = np.rint(exact)
    same = same_rows(list(exact.T))
    one_each = np.flatnonzero(same == np.arange(len(same)))
    low = places.min(axis=0) - _FARTHEST
    key = _keys(places - low)
    found, owner = np.unique(key[one_each], return_index=True)
    is_owner = np.zeros(len(one_each), bool)
    is_owner[owner] = True
    taken: set[int] = set()
    for vertex in one_each[~is_owner]:
        for reach in _REACHES:
            near = places[vertex] + _around(reach)
            near_keys = _keys(near - low)
            at = np.searchsorted(found, near_keys).clip(max=len(found) - 1)
            free = [i for i in np.flatnonzero(found[at] != near_keys) if int(near_keys[i]) not in taken]
            if free:
                break
        else:
            return None
        away = ((near[free] - exact[vertex]) ** 2).sum(axis=1)
        best = free[int(np.argmin(away))]
        places[vertex] = near[best]
        taken.add(int(near_keys[best]))
    return np.asarray(places[same] + 0.0)  # no zero has a sign


@cache
def _around(reach: int) -> Floats:
    """Return the steps (k, 3) to all places no farther than this along each axis."""
    return np.array(list(itertools.product(range(-reach, reach + 1), repeat=3)), np.float64)


def _keys(places: Floats) -> Ids:
    """Return one number for each place, which has three of 21 bits."""
    x, y, z = places.astype(np.int64).T
    return np.asarray((z << 42) | (y << 21) | x)
