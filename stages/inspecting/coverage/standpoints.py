"""Viewpoints for capturing defects: in free space, frontal, at the usual distance."""

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

# Number of candidate directions, minimum cosine to the normal, and distances as multiples of the usual one.
_DIRECTIONS = 192
_LEAST_COSINE = 0.1
_DISTANCES = (1.0, 0.6, 1.5)
# Number of points per defect tested for visibility.
_POINTS = 12
# Ratio of the distance to a point within which surface counts as an occluder; beyond it is the defect itself.
_BEFORE = 0.93
# Maximum number of camera positions; viewpoints near existing cameras are preferred.
_CAMERAS = 500
# Patches per batch of rays; each patch takes about 7,000 rays.
_AT_ONCE = 100
# Score factors of a viewpoint in unknown space and outside the grid (free space: 1). Then penalty per usual
# distance from the nearest camera, and penalty per factor of e from the usual distance to the defect.
_UNKNOWN, _OUTSIDE, _AWAY, _DISTANCE = 0.5, 0.7, 1.0, 0.3


@dataclass(frozen=True)
class Standpoint:
    """Suggested viewpoint for capturing a defect.

    Attributes
    ----------
    position : world coordinates, metres.
    direction : unit vector from the position to the defect.
    sees : ratio of the defect visible from the position.
    is_free : True if frames looked through the position, or if it is outside the grid.
    """

    position: tuple[float, float, float]
    direction: tuple[float, float, float]
    sees: float
    is_free: bool


@dataclass(frozen=True, eq=False)
class _Looks:
    """Candidate viewpoints of a patch, with rays to the patch's points.

    Attributes
    ----------
    places : (p, 3) candidate positions.
    reaches : (p,) distances from the patch's middle, metres.
    middle : (3,) middle of the patch.
    rays, lengths : (p, k, 3) unit directions to the points, and (p, k) distances in metres.
    straight : (p, k) cosines between the rays and the patch's normal; 0 from behind.
    """

    places: Floats
    reaches: Floats
    middle: Floats
    rays: Floats
    lengths: Floats
    straight: Floats


class Standing:
    """Planner of viewpoints around a scan.

    Parameters
    ----------
    space : space carved by the frames.
    sight : occlusion test in world coordinates.
    cameras : (c, 3) camera positions in world coordinates, metres.
    usual : median viewing distance, metres.
    origin : (3,) origin of the coordinates of patches and space.
    """

    def __init__(self, space: Space, sight: Sight, cameras: Floats, usual: float, origin: Floats) -> None:
        rows = sample_evenly(len(cameras), _CAMERAS)
        self._space, self._sight, self._usual = space, sight, usual
        self._cameras = cameras[rows] - origin
        self.origin = origin

    def best(self, patches: Sequence[Patch]) -> list[Standpoint]:
        """Return the best viewpoint for each patch."""
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
        """Return the candidate with the highest score.

        Parameters
        ----------
        looks : candidate viewpoints.
        is_seen : (p, k) visibility of each point from each candidate.
        """
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
        """Generate the candidate viewpoints of a patch."""
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
    # Fibonacci spiral: the golden angle between consecutive points.
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - 5**0.5)
    level = np.sqrt(1 - z * z)
    return np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=1)


def _numbers(point: Floats) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in point)
    return x, y, z
