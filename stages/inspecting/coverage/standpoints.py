"""From where one should look at a place: from free space, straight at it, from about as near as usual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.coverage.patches import Patch
from scanloom.stages.inspecting.coverage.sight import Sight
from scanloom.stages.inspecting.coverage.space import Space
from scanloom.stages.inspecting.coverage.views import Floats

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
# Patches that are looked at at a time, by some 7,000 rays each.
_AT_ONCE = 100
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


@dataclass(frozen=True, eq=False)
class _Looks:
    """Places (p, 3) that are tried, `reaches` (p,) from the middle (3,), and lines from there to points.

    `rays` (p, k, 3) are unit, `lengths` (p, k) metres, `straight` (p, k) their cosines to the patch.
    """

    places: Floats
    reaches: Floats
    middle: Floats
    rays: Floats
    lengths: Floats
    straight: Floats


class Standing:
    """Where one can stand around a scan.

    Parameters
    ----------
    space : that frames have seen.
    sight : what may be in the way, in the axes of the scan.
    cameras : (c, 3) where frames were taken, likewise, metres.
    usual : metres, from where places are seen.
    origin : (3,) what points of patches and of space are counted from.
    """

    def __init__(self, space: Space, sight: Sight, cameras: Floats, usual: float, origin: Floats) -> None:
        rows = sample_evenly(len(cameras), _CAMERAS)
        self._space, self._sight, self._usual = space, sight, usual
        self._cameras = cameras[rows] - origin
        self.origin = origin

    def best(self, patches: Sequence[Patch]) -> list[Standpoint]:
        """Return the best place to look at each patch from."""
        found = []
        for start in range(0, len(patches), _AT_ONCE):
            some = [self._looks(patch) for patch in patches[start : start + _AT_ONCE]]
            rays, lengths = (
                np.concatenate([values.reshape(-1, *values.shape[2:]) for values in columns])
                for columns in zip(*((one.rays, one.lengths) for one in some), strict=True)
            )
            places = np.concatenate([np.repeat(one.places, one.lengths.shape[1], axis=0) for one in some])
            met = self._sight.is_met(places + self.origin, rays, _BEFORE * lengths)
            ends = np.cumsum([one.lengths.size for one in some])
            for one, hidden in zip(some, np.split(met, ends[:-1]), strict=True):
                found.append(self._best(one, ~hidden.reshape(one.lengths.shape)))
        return found

    def _best(self, looks: _Looks, is_seen: NDArray[np.bool_]) -> Standpoint:
        """Return the best of some places, from which points (p, k) are seen."""
        is_outside = ~self._space.is_inside(looks.places)
        is_free = self._space.is_free(looks.places)
        away = np.linalg.norm(looks.places[:, None] - self._cameras[None], axis=2).min(axis=1) / self._usual
        room = np.select([is_free, is_outside], [1.0, _OUTSIDE], _UNKNOWN)
        score = (is_seen * looks.straight).mean(axis=1) * room
        score /= (1 + _AWAY * away) * (1 + _DISTANCE * np.abs(np.log(looks.reaches / self._usual)))
        best = int(score.argmax())
        return Standpoint(
            _numbers(looks.places[best] + self.origin),
            _numbers((looks.middle - looks.places[best]) / looks.reaches[best]),
            float(is_seen[best].mean()),
            bool(is_free[best] | is_outside[best]),
        )

    def _looks(self, patch: Patch) -> _Looks:
        """Return how places around a patch look at it."""
        normal, middle = patch.normal, patch.middle
        directions = _spread_directions(_DIRECTIONS)
        if normal.any():
            directions = directions[directions @ normal > _LEAST_COSINE]
        reaches = np.repeat(np.array(_DISTANCES) * self._usual, len(directions))
        places = middle + reaches[:, None] * np.tile(directions, (len(_DISTANCES), 1))
        rows = sample_evenly(len(patch.points), _POINTS)
        lines = patch.points[rows][None] - places[:, None]
        lengths = np.linalg.norm(lines, axis=2)
        rays = lines / np.maximum(lengths, np.finfo(np.float64).tiny)[..., None]
        straight = np.maximum(-(rays @ normal), 0.0) if normal.any() else np.ones_like(lengths)
        return _Looks(places, reaches, middle, rays, lengths, straight)


def _spread_directions(count: int) -> Floats:
    """Spread unit directions (count, 3) evenly over the sphere."""
    # Along a spiral, by the golden angle.
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - 5**0.5)
    level = np.sqrt(1 - z * z)
    return np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=1)


def _numbers(point: Floats) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in point)
    return x, y, z
