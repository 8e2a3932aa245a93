"""Whether what nobody saw is a gap in a scan, or where the scan just ends.

The wall of a room that nobody looked at stands between others, on floor and below a ceiling: there is surface
all around it. Where a scan ends there is surface on one side alone.
"""

from __future__ import annotations

import numpy as np

from scanloom.stages.inspecting.coverage.sight import Sight
from scanloom.stages.inspecting.coverage.views import Floats

# Directions in the plane of a patch, and how far they are turned out of it, degrees: to both sides, because
# what goes on beside it may lie a little before or behind it.
_DIRECTIONS = 72
_TILTS = (-5.0, 0.0, 5.0)
# Places that are looked around at a time.
_AT_ONCE = 1000


def open_sectors(middles: Floats, normals: Floats, sight: Sight, reach: float) -> Floats:
    """Return the widest sector (k,), degrees, without surface around each place; 360 if there is none.

    Parameters
    ----------
    middles : (k, 3) metres, in the axes of the surface.
    normals : (k, 3) to where one looks at each place from; 0 if that is everywhere.
    reach : metres, up to which surface counts.
    """
    sectors = np.full(len(middles), 360.0)
    (rows,) = np.nonzero(normals.any(axis=1))
    for start in range(0, len(rows), _AT_ONCE):
        some = rows[start : start + _AT_ONCE]
        rays = np.stack([_around(normal) for normal in normals[some]])
        count = rays.shape[1]
        met = sight.is_met(
            np.repeat(middles[some], count, axis=0), rays.reshape(-1, 3), np.full(len(some) * count, reach)
        )
        hits = met.reshape(len(some), len(_TILTS), _DIRECTIONS)
        for row, at_tilts in zip(some, hits, strict=True):
            (ways,) = np.nonzero(at_tilts.any(axis=0))
            if len(ways):
                widest = np.diff(ways, append=ways[0] + _DIRECTIONS).max()
                sectors[row] = float(widest) * 360 / _DIRECTIONS
    return sectors


def _around(normal: Floats) -> Floats:
    """Return directions (k, 3) all around a normal, for each tilt all of them."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    level = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(normal, across)
    tilts = np.radians(_TILTS)
    rays = np.cos(tilts)[:, None, None] * level + np.sin(tilts)[:, None, None] * normal
    return np.asarray(rays.reshape(-1, 3), np.float64)
