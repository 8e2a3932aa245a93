"""From where one should look at a place: from free space, straight at it, about as near as the scan was made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.coverage.directions import all_around
from stages.coverage.space import Space
from stages.coverage.views import Floats
from stages.surface.raycasting import Surface

# Directions that are tried, and distances, of the usual one.
_DIRECTIONS = 96
_LEAST_COSINE = 0.1
_DISTANCES = (1.0, 0.6, 1.5)
# Points of the place that must be in sight.
_POINTS = 12
# Of the way to a point, what lies before it: what is nearer to the end is the place itself.
_BEFORE = 0.93
# What it costs to stand where nobody knows that there is room, as far away from all cameras as one usually looks,
# and at another distance than the usual one: of a straight look at all of the place.
_UNKNOWN, _AWAY, _DISTANCE = 0.5, 0.15, 0.2


@dataclass(frozen=True)
class Standpoint:
    """Where to stand.

    Attributes
    ----------
    position : metres, in the scan's world.
    direction : unit, from there to the middle of the place.
    sees : share of the place that is in sight from there.
    is_free : whether frames looked through where it is, or it is beyond all surface.
    """

    position: tuple[float, float, float]
    direction: tuple[float, float, float]
    sees: float
    is_free: bool


def standpoint(
    points: Floats,
    normal: Floats,
    middle: Floats,
    space: Space,
    surface: Surface,
    cameras: Floats,
    usual: float,
    origin: Floats,
) -> Standpoint:
    """Return the best place to look from.

    Parameters
    ----------
    points : (k, 3) of the place, from the origin on, metres, as `middle`, (3,).
    normal : (3,) to where it faces.
    surface : what may be in the way, in the axes of the scan.
    cameras : (c, 3) where frames were taken, from the origin on.
    usual : metres, from where places are seen.
    """
    directions = _hemisphere(normal)
    reaches = np.repeat(np.array(_DISTANCES) * usual, len(directions))
    tried = middle + reaches[:, None] * np.tile(directions, (len(_DISTANCES), 1))
    rows = np.linspace(0, len(points) - 1, min(_POINTS, len(points))).round().astype(int)
    targets = points[rows]
    lines = targets[None] - tried[:, None]
    lengths = np.linalg.norm(lines, axis=2)
    unit = lines / np.maximum(lengths, 1e-9)[..., None]
    starts = np.repeat(tried + origin, len(targets), axis=0)
    hits = surface.cast(starts, unit.reshape(-1, 3))
    sight = np.ones(lengths.size, bool)
    sight[hits.rays] = hits.distances > _BEFORE * lengths.reshape(-1)[hits.rays]
    sight = sight.reshape(lengths.shape)
    straight = np.maximum(-(unit @ normal), 0.0) if normal.any() else np.ones_like(lengths)
    is_free = ~space.is_inside(tried) | space.is_free(tried)
    away = np.linalg.norm(tried[:, None] - cameras[None], axis=2).min(axis=1)
    score = (sight * straight).mean(axis=1)
    score -= _UNKNOWN * ~is_free + _AWAY * np.minimum(away / usual, 3.0)
    score -= _DISTANCE * np.abs(np.log(reaches / usual))
    best = int(score.argmax())
    towards = (middle - tried[best]) / reaches[best]
    return Standpoint(
        _numbers(tried[best] + origin), _numbers(towards), float(sight[best].mean()), bool(is_free[best])
    )


def _numbers(point: Floats) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in point)
    return x, y, z


def _hemisphere(normal: Floats) -> Floats:
    """Return directions to the side a normal looks to; all around for none."""
    directions = all_around(2 * _DIRECTIONS)
    return directions[directions @ normal > _LEAST_COSINE] if normal.any() else directions
