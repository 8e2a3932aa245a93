"""Detection of images that were rotated by 180° after calibration.

Data sets of objects often store images upright, while the poses belong to the original images. Corner matches
reveal it: they are on each other's epipolar lines only if both images match their poses. Two rotated images
fit almost as well, so that all views are decided together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.stereo.epipolar import compute_epipolar_distance, compute_fundamental_matrix
from scanloom.stages.stereo.posed_views import PosedView

_MAX_CORNERS = 1000
# Minimum image side, px: ORB patches are 31 px wide.
_MIN_SIDE_PX = 32
# Maximum Hamming distance of ORB descriptors (of 256 bits) for the same point.
_MAX_HAMMING_DISTANCE = 40
# Maximum epipolar distance relative to the image diagonal: 1.6 px for 640×480.
_TOLERANCE_RATIO = 0.002
# Images are rotated if at least this number of matches fit after rotation, and this factor more than before.
_MIN_MATCHES = 40
_MIN_IMPROVEMENT_FACTOR = 1.25


@dataclass(frozen=True, eq=False)
class ImageCorners:
    """Corners of an image.

    Attributes
    ----------
    points : (n, 2) float64 pixels.
    descriptors : n ORB descriptors, or None.
    """

    points: NDArray[np.float64]
    descriptors: Any


@dataclass(frozen=True, eq=False)
class _RotationEvidence:
    """Number of inlier matches of two views for each combination of rotations.

    Attributes
    ----------
    first, second : indices of the views.
    counts : (2, 2); `counts[a, b]` has the first view rotated if a is 1, and the second if b is 1.
    """

    first: int
    second: int
    counts: NDArray[np.int64]

    @property
    def is_relative_rotation(self) -> bool:
        """Return True if the images are rotated relative to each other."""
        return self._different_count > self._same_count

    @property
    def margin(self) -> int:
        """Return the margin of inliers for the decision of `is_relative_rotation`."""
        return abs(self._different_count - self._same_count)

    @property
    def _same_count(self) -> int:
        return int(max(self.counts[0, 0], self.counts[1, 1]))

    @property
    def _different_count(self) -> int:
        return int(max(self.counts[0, 1], self.counts[1, 0]))


def detect_corners(grey: NDArray[np.uint8]) -> ImageCorners:
    """Detect the corners of an image (h, w)."""
    import cv2

    if min(grey.shape) < _MIN_SIDE_PX:
        return ImageCorners(np.empty((0, 2)), None)
    found, descriptors = cv2.ORB.create(_MAX_CORNERS).detectAndCompute(grey, None)
    return ImageCorners(np.array([one.pt for one in found], np.float64).reshape(-1, 2), descriptors)


def find_upside_down(
    views: Sequence[PosedView], found: Sequence[ImageCorners | None], pairs: Sequence[tuple[int, int]]
) -> list[bool]:
    """Decide which images are rotated by 180° relative to their poses.

    Parameters
    ----------
    found : corners of each view's image; None if the image is unreadable.
    pairs : indices of overlapping views.

    Returns
    -------
    True for each view whose image is rotated.
    """
    fits = []
    for first, second in pairs:
        here, there = found[first], found[second]
        if here is not None and there is not None:
            fits.append(
                _RotationEvidence(
                    first, second, _count_rotation_inliers(views[first], views[second], here, there)
                )
            )
    fits.sort(key=lambda fit: -fit.margin)
    group, parity = _group_views(len(views), fits)
    result = [False] * len(views)
    for name in sorted(set(group)):
        group_fits = [fit for fit in fits if group[fit.first] == name]
        inlier_totals = [
            sum(_count_inliers(fit, parity, flip) for fit in group_fits) for flip in (False, True)
        ]
        flip = inlier_totals[1] > inlier_totals[0]
        members = [at for at in range(len(views)) if group[at] == name and parity[at] != flip]
        member_fits = [fit for fit in group_fits if {fit.first, fit.second} & set(members)]
        inliers_rotated = sum(_count_inliers(fit, parity, flip) for fit in member_fits)
        inliers_unrotated = sum(int(fit.counts[0, 0]) for fit in member_fits)
        if inliers_rotated >= max(_MIN_MATCHES, _MIN_IMPROVEMENT_FACTOR * inliers_unrotated):
            for at in members:
                result[at] = True
    return result


def _count_inliers(fit: _RotationEvidence, parity: Sequence[bool], flip: bool) -> int:
    return int(fit.counts[int(parity[fit.first] != flip), int(parity[fit.second] != flip)])


def _group_views(count: int, fits: Sequence[_RotationEvidence]) -> tuple[list[int], list[bool]]:
    """Group views that are linked by matches.

    Links are merged in order of evidence. Links within a group are ignored.

    Returns
    -------
    The group of each view, and for each view True if it is rotated relative to the first view of the group.
    """
    group, parity = list(range(count)), [False] * count
    for fit in fits:
        kept, joined = group[fit.first], group[fit.second]
        if kept == joined or fit.margin == 0:
            continue
        change = parity[fit.first] ^ parity[fit.second] ^ fit.is_relative_rotation
        for at in range(count):
            if group[at] == joined:
                group[at], parity[at] = kept, parity[at] ^ change
    return group, parity


def _count_rotation_inliers(
    first: PosedView, second: PosedView, here: ImageCorners, there: ImageCorners
) -> NDArray[np.int64]:
    import cv2

    counts = np.zeros((2, 2), np.int64)
    if here.descriptors is None or there.descriptors is None:
        return counts
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(here.descriptors, there.descriptors)
    same = [(one.queryIdx, one.trainIdx) for one in matches if one.distance < _MAX_HAMMING_DISTANCE]
    if not same:
        return counts
    at = np.array(same)
    sides = (_rotate_points(here.points[at[:, 0]], first), _rotate_points(there.points[at[:, 1]], second))
    lines = compute_fundamental_matrix(first, second)
    limit = _TOLERANCE_RATIO * float(np.hypot(second.camera.width, second.camera.height))
    for a, one in enumerate(sides[0]):
        for b, other in enumerate(sides[1]):
            counts[a, b] = np.count_nonzero(compute_epipolar_distance(lines, one, other) <= limit)
    return counts


def _rotate_points(
    points: NDArray[np.float64], view: PosedView
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (n, 2) unchanged, and rotated about the image centre.

    The rotation is 180°.
    """
    return points, np.array((view.camera.width - 1, view.camera.height - 1)) - points
