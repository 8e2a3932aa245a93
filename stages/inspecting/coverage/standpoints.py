"""From where one should look at a place: from free space, straight at it, from about as near as usual."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.inspecting.coverage.directions import all_around
from stages.inspecting.coverage.patches import Patch
from stages.inspecting.coverage.space import Space
from stages.inspecting.coverage.views import Floats
from stages.surface.raycasting import Surface

# Directions that are tried, those not too flat, and distances, of the usual one.
_DIRECTIONS = 192
_LEAST_COSINE = 0.1
_DISTANCES = (1.0, 0.6, 1.5)
# Points of the place that must be in sight.
_POINTS = 12
# Of the way to a point, what lies before it: what is nearer to the end is the place itself.
_BEFORE = 0.93
# Cameras that a standpoint should be near to.
_CAMERAS = 500
# What a straight look at all of a place is worth from where nobody knows that there is room, within the scan
# or outside; and how much less it is for each usual distance away from all cameras, and for each factor of e
# from that distance to the place.
_UNKNOWN, _OUTSIDE, _AWAY, _DISTANCE = 0.5, 0.7, 1.0, 0.3


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


class Standing:
    """Where one can stand around a scan.

    Parameters
    ----------
    space : that frames have seen.
    surface : what may be in the way, in the axes of the scan.
    cameras : (c, 3) where frames were taken, likewise, metres.
    usual : metres, from where places are seen.
    origin : (3,) what points of patches and of space are counted from.
    """

    def __init__(self, space: Space, surface: Surface, cameras: Floats, usual: float, origin: Floats) -> None:
        rows = np.linspace(0, len(cameras) - 1, min(_CAMERAS, len(cameras))).round().astype(int)
        self._space, self._surface, self._usual = space, surface, usual
        self._cameras = cameras[rows] - origin
        self.origin = origin

    def best(self, patch: Patch) -> Standpoint:
        """Return the best place to look at a patch from."""
        normal, middle = patch.normal, patch.middle
        directions = all_around(_DIRECTIONS)
        if normal.any():
            directions = directions[directions @ normal > _LEAST_COSINE]
        reaches = np.repeat(np.array(_DISTANCES) * self._usual, len(directions))
        tried = middle + reaches[:, None] * np.tile(directions, (len(_DISTANCES), 1))
        sight, straight = self._looks(tried, patch.points, normal)
        is_outside = ~self._space.is_inside(tried)
        is_free = self._space.is_free(tried)
        away = np.linalg.norm(tried[:, None] - self._cameras[None], axis=2).min(axis=1) / self._usual
        room = np.select([is_free, is_outside], [1.0, _OUTSIDE], _UNKNOWN)
        score = (sight * straight).mean(axis=1) * room
        score /= (1 + _AWAY * away) * (1 + _DISTANCE * np.abs(np.log(reaches / self._usual)))
        best = int(score.argmax())
        return Standpoint(
            _numbers(tried[best] + self.origin),
            _numbers((middle - tried[best]) / reaches[best]),
            float(sight[best].mean()),
            bool(is_free[best] | is_outside[best]),
        )

    def _looks(self, places: Floats, points: Floats, normal: Floats) -> tuple[Floats, Floats]:
        """Return which points are in sight of places (p, k), and the cosines of how these see them (p, k)."""
        rows = np.linspace(0, len(points) - 1, min(_POINTS, len(points))).round().astype(int)
        lines = points[rows][None] - places[:, None]
        lengths = np.linalg.norm(lines, axis=2)
        unit = lines / np.maximum(lengths, np.finfo(np.float64).tiny)[..., None]
        hits = self._surface.cast(np.repeat(places + self.origin, len(rows), axis=0), unit.reshape(-1, 3))
        sight = np.ones(lengths.size)
        sight[hits.rays] = hits.distances > _BEFORE * lengths.reshape(-1)[hits.rays]
        straight = np.maximum(-(unit @ normal), 0.0) if normal.any() else np.ones_like(lengths)
        return sight.reshape(lengths.shape), straight


def _numbers(point: Floats) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in point)
    return x, y, z
