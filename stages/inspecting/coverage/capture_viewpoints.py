"""Viewpoints for capturing defects: in free space, frontal, at the usual distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.coverage.carved_space import CarvedSpace
from scanloom.stages.inspecting.coverage.defect_patches import DefectPatch
from scanloom.stages.inspecting.coverage.depth_view import Floats
from scanloom.stages.inspecting.coverage.occlusion_test import OcclusionTest

# Number of candidate directions, minimum cosine to the normal, and distances as multiples of the usual one.
_DIRECTION_COUNT = 192
_MIN_COSINE = 0.1
_DISTANCE_FACTORS = (1.0, 0.6, 1.5)
# Number of points per defect tested for visibility.
_VISIBILITY_SAMPLES = 12
# Ratio of the distance to a point within which surface counts as an occluder; beyond it is the defect itself.
_OCCLUDER_DISTANCE_RATIO = 0.93
# Maximum number of camera positions; viewpoints near existing cameras are preferred.
_MAX_CAMERAS = 500
# Patches per batch of rays; each patch takes about 7,000 rays.
_BATCH_SIZE = 100
# Score factors of a viewpoint in unknown space and outside the grid (free space: 1). Then penalty per usual
# distance from the nearest camera, and penalty per factor of e from the usual distance to the defect.
_UNKNOWN_SCORE, _OUTSIDE_SCORE, _CAMERA_PENALTY, _DISTANCE_PENALTY = 0.5, 0.7, 1.0, 0.3


@dataclass(frozen=True)
class CaptureViewpoint:
    """Suggested viewpoint for capturing a defect.

    Attributes
    ----------
    position : world coordinates, metres.
    direction : unit vector from the position to the defect.
    visible_ratio : ratio of the defect visible from the position.
    is_free : True if frames looked through the position, or if it is outside the grid.
    """

    position: tuple[float, float, float]
    direction: tuple[float, float, float]
    visible_ratio: float
    is_free: bool


@dataclass(frozen=True, eq=False)
class _ViewCandidates:
    """Candidate viewpoints of a patch, with rays to the patch's points.

    Attributes
    ----------
    positions : (p, 3) candidate positions.
    distances : (p,) distances from the patch's middle, metres.
    middle : (3,) middle of the patch.
    rays, lengths : (p, k, 3) unit directions to the points, and (p, k) distances in metres.
    cosines : (p, k) cosines between the rays and the patch's normal; 0 from behind.
    """

    positions: Floats
    distances: Floats
    middle: Floats
    rays: Floats
    lengths: Floats
    cosines: Floats


class ViewpointPlanner:
    """Planner of viewpoints around a scan.

    Parameters
    ----------
    space : space carved by the frames.
    sight : occlusion test in world coordinates.
    cameras : (c, 3) camera positions in world coordinates, metres.
    usual : median viewing distance, metres.
    origin : (3,) origin of the coordinates of patches and space.
    """

    def __init__(
        self,
        space: CarvedSpace,
        occlusion: OcclusionTest,
        cameras: Floats,
        median_distance: float,
        origin: Floats,
    ) -> None:
        rows = sample_evenly(len(cameras), _MAX_CAMERAS)
        self._space, self._occlusion, self._median_distance = space, occlusion, median_distance
        self._cameras = cameras[rows] - origin
        self.origin = origin

    def find_best_viewpoints(self, patches: Sequence[DefectPatch]) -> list[CaptureViewpoint]:
        """Return the best viewpoint for each patch."""
        found = []
        for start in range(0, len(patches), _BATCH_SIZE):
            some = [self._make_candidates(patch) for patch in patches[start : start + _BATCH_SIZE]]
            rays, lengths = (
                np.concatenate([values.reshape(-1, *values.shape[2:]) for values in columns])
                for columns in zip(*((one.rays, one.lengths) for one in some), strict=True)
            )
            places = np.concatenate([np.repeat(one.positions, one.lengths.shape[1], axis=0) for one in some])
            met = self._occlusion.is_hit(places + self.origin, rays, _OCCLUDER_DISTANCE_RATIO * lengths)
            ends = np.cumsum([one.lengths.size for one in some])
            for one, hidden in zip(some, np.split(met, ends[:-1]), strict=True):
                found.append(self._select_best(one, ~hidden.reshape(one.lengths.shape)))
        return found

    def _select_best(self, candidates: _ViewCandidates, is_visible: NDArray[np.bool_]) -> CaptureViewpoint:
        """Return the candidate with the highest score.

        Parameters
        ----------
        candidates : candidate viewpoints.
        is_visible : (p, k) visibility of each point from each candidate.
        """
        is_outside = ~self._space.is_inside(candidates.positions)
        is_free = self._space.is_free(candidates.positions)
        camera_distance = (
            np.linalg.norm(candidates.positions[:, None] - self._cameras[None], axis=2).min(axis=1)
            / self._median_distance
        )
        free_space_factor = np.select([is_free, is_outside], [1.0, _OUTSIDE_SCORE], _UNKNOWN_SCORE)
        score = (is_visible * candidates.cosines).mean(axis=1) * free_space_factor
        score /= (1 + _CAMERA_PENALTY * camera_distance) * (
            1 + _DISTANCE_PENALTY * np.abs(np.log(candidates.distances / self._median_distance))
        )
        best = int(score.argmax())
        return CaptureViewpoint(
            _round_point(candidates.positions[best] + self.origin),
            _round_point((candidates.middle - candidates.positions[best]) / candidates.distances[best]),
            float(is_visible[best].mean()),
            bool(is_free[best] | is_outside[best]),
        )

    def _make_candidates(self, patch: DefectPatch) -> _ViewCandidates:
        """Generate the candidate viewpoints of a patch."""
        normal, middle = patch.normal, patch.middle
        directions = _spread_directions(_DIRECTION_COUNT)
        if normal.any():
            directions = directions[directions @ normal > _MIN_COSINE]
        reaches = np.repeat(np.array(_DISTANCE_FACTORS) * self._median_distance, len(directions))
        places = middle + reaches[:, None] * np.tile(directions, (len(_DISTANCE_FACTORS), 1))
        rows = sample_evenly(len(patch.points), _VISIBILITY_SAMPLES)
        lines = patch.points[rows][None] - places[:, None]
        lengths = np.linalg.norm(lines, axis=2)
        rays = lines / np.maximum(lengths, np.finfo(np.float64).tiny)[..., None]
        straight = np.maximum(-(rays @ normal), 0.0) if normal.any() else np.ones_like(lengths)
        return _ViewCandidates(places, reaches, middle, rays, lengths, straight)


def _spread_directions(count: int) -> Floats:
    """Spread unit directions (count, 3) evenly over the sphere."""
    # Fibonacci spiral: the golden angle between consecutive points.
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - 5**0.5)
    level = np.sqrt(1 - z * z)
    return np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=1)


def _round_point(point: Floats) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in point)
    return x, y, z
