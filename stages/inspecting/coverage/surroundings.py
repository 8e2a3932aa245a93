"""Whether what nobody saw is a gap in a scan, or where the scan just ends.

The wall of a room that nobody looked at stands between others, on floor and below a ceiling: there is surface
all around it. Where a scan ends there is surface on one side alone.
"""

from __future__ import annotations

import numpy as np

from stages.inspecting.coverage.views import Floats
from stages.surface.raycasting import Surface

# Directions in the plane of a patch, and how far they are turned out of it, degrees: to both sides, because
# what goes on beside it may lie a little before or behind it.
_DIRECTIONS = 72
_TILTS = (-5.0, 0.0, 5.0)


def open_sector(middle: Floats, normal: Floats, surface: Surface, reach: float) -> float:
    """Return the widest sector, degrees, in which there is no surface around a place; 360 if there is none.

    Parameters
    ----------
    middle : (3,) metres, in the axes of the surface.
    normal : (3,) to where one looks at the place from; 0 if that is everywhere.
    reach : metres, up to which surface counts.
    """
    if not normal.any():
        return 360.0
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    level = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(normal, across)
    tilts = np.radians(_TILTS)
    rays = np.cos(tilts)[:, None, None] * level + np.sin(tilts)[:, None, None] * normal
    hits = surface.cast(middle, rays.reshape(-1, 3))
    met = np.unique(hits.rays[hits.distances <= reach] % _DIRECTIONS)
    if not len(met):
        return 360.0
    return float(np.diff(met, append=met[0] + _DIRECTIONS).max() * 360 / _DIRECTIONS)
