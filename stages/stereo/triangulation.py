"""Triangulation of feature matches between posed views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.features import Keypoints, match_descriptors
from scanloom.stages.stereo.epipolar import compute_symmetric_distance
from scanloom.stages.stereo.posed_views import PosedView

# Each view is paired with its nearest, second-nearest, fourth-nearest … neighbour of similar direction. The
# nearest frames of a video have too little parallax, the farthest see something else.
_NEIGHBOUR_RANKS = (1, 2, 4, 8, 16)
# Maximum angle between the optical axes of a pair, degrees.
_MAX_AXIS_ANGLE_DEG = 45.0
# Maximum epipolar distance of a match relative to the image diagonal: 8 px for 640×480. Poses from phones
# have errors of several pixels.
_TOLERANCE_RATIO = 0.01
# Minimum number of inliers, and minimum ratio of inliers among the matches, for views that overlap.
_MIN_INLIERS, _MIN_INLIER_RATIO = 12, 0.3
# Minimum triangulation angle for depth: degrees, and multiples of the median epipolar error of the pair.
_MIN_ANGLE_DEG, _MIN_ANGLE_DEVIATIONS = 1.0, 5.0


@dataclass(frozen=True, eq=False)
class VerifiedMatches:
    """Verified matches of two views.

    Attributes
    ----------
    epipolar_error : median epipolar distance of the inliers, pixels. Values above one mean that poses or
        calibration do
        not fit the images.
    depths : triangulated depths (n,) of well-conditioned matches, metres, in the first and the second view.
    pixels : inlier pixels (n, 2) in the first and the second view.
    """

    epipolar_error: float
    depths: tuple[NDArray[np.float64], NDArray[np.float64]]
    pixels: tuple[NDArray[np.float64], NDArray[np.float64]]


def find_overlapping_pairs(views: Sequence[PosedView]) -> list[tuple[int, int]]:
    """Return sorted index pairs of views that may overlap.

    Poses decide: the optical axes must be within 45°, and the distance of the views is small.
    """
    centres = np.stack([view.centre for view in views])
    axes = np.stack([view.world_from_camera[:3, 2] for view in views])
    pairs: set[tuple[int, int]] = set()
    for at in range(len(views)):
        apart = np.linalg.norm(centres - centres[at], axis=1)
        alike = np.flatnonzero((apart > 0) & (axes @ axes[at] > math.cos(math.radians(_MAX_AXIS_ANGLE_DEG))))
        order = alike[np.argsort(apart[alike], kind="stable")]
        pairs |= {
            (min(at, int(order[n - 1])), max(at, int(order[n - 1])))
            for n in _NEIGHBOUR_RANKS
            if n <= len(order)
        }
    return sorted(pairs)


def match_views(
    first: PosedView, second: PosedView, here: Keypoints, there: Keypoints
) -> VerifiedMatches | None:
    """Match keypoints of two views, and triangulate the inliers.

    Parameters
    ----------
    here, there : keypoints of both undistorted images.

    Returns
    -------
    The verified matches; None if the views do not overlap.
    """
    same = match_descriptors(here.descriptors, there.descriptors)
    one, other = (
        points.pixels[same[:, side]].astype(np.float64) for side, points in enumerate((here, there))
    )
    distances = compute_symmetric_distance(first, second, one, other)
    is_inlier = distances <= _TOLERANCE_RATIO * math.hypot(first.camera.width, first.camera.height)
    if np.count_nonzero(is_inlier) < max(_MIN_INLIERS, _MIN_INLIER_RATIO * len(same)):
        return None
    rays = [
        view.compute_rays(*points[is_inlier].T) @ view.world_from_camera[:3, :3].T
        for view, points in ((first, one), (second, other))
    ]
    median_distance = float(np.median(distances[is_inlier]))
    angle = max(math.radians(_MIN_ANGLE_DEG), _MIN_ANGLE_DEVIATIONS * median_distance / first.camera.fx)
    depths = _triangulate_rays(rays[0], rays[1], second.centre - first.centre, angle)
    return VerifiedMatches(median_distance, depths, (one[is_inlier], other[is_inlier]))


def _triangulate_rays(
    first: NDArray[np.float64], second: NDArray[np.float64], baseline: NDArray[np.float64], min_angle: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Triangulate pairs of rays by their closest points.

    Parameters
    ----------
    first, second : (n, 3) rays in world axes, with z = 1 in their cameras.
    baseline : (3,) vector from the first to the second camera centre.
    min_angle : minimum angle between the rays, radians.

    Returns
    -------
    Depths along both rays, without rays below the minimum angle and points behind a camera.
    """
    aa, bb, ab = ((u * v).sum(axis=1) for u, v in ((first, first), (second, second), (first, second)))
    wide = ab < math.cos(min_angle) * np.sqrt(aa * bb)
    aa, bb, ab, to_a, to_b = aa[wide], bb[wide], ab[wide], first[wide] @ baseline, second[wide] @ baseline
    determinant = aa * bb - ab**2
    here, there = (bb * to_a - ab * to_b) / determinant, (ab * to_a - aa * to_b) / determinant
    before = (here > 0) & (there > 0)
    return here[before], there[before]
