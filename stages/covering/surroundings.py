"""Whether what nobody saw is a gap in a scan, or where the scan just ends.

A gap has surface around it: one that was left out of a wall goes on to its left and to its right, and the
wall of a room that nobody looked at stands between others. Where a scan ends there is surface on one side
alone.
"""

from __future__ import annotations

import numpy as np

from stages.covering.views import Floats
from stages.surface.raycasting import Surface

# Directions in the plane of a patch, and how far they are turned out of it, degrees: to both sides, because
# what goes on beside a gap may lie a little before or behind it.
_DIRECTIONS = 72
_TILTS = (-25.0, 0.0, 25.0)
# Of the circle around a patch, degrees: without surface in a wider sector it is open to that side.
_OPEN = 135.0


def is_gap(middle: Floats, normal: Floats, surface: Surface, reach: float) -> bool:
    """Return whether there is surface around a place on all sides but one sector at most.

    Parameters
    ----------
    middle : (3,) metres, in the axes of the surface.
    normal : (3,) to where one looks at the place from; 0 if that is everywhere.
    reach : metres, up to which surface counts.
    """
    if not normal.any():
        return False
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    level = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(normal, across)
    tilts = np.radians(_TILTS)
    rays = np.cos(tilts)[:, None, None] * level + np.sin(tilts)[:, None, None] * normal
    hits = surface.cast(middle, rays.reshape(-1, 3))
    is_met = np.zeros(_DIRECTIONS, bool)
    is_met[hits.rays[hits.distances <= reach] % _DIRECTIONS] = True
    (met,) = np.nonzero(is_met)
    if not len(met):
        return False
    widest = np.diff(met, append=met[0] + _DIRECTIONS).max()
    return bool(widest * 360 / _DIRECTIONS < _OPEN)
