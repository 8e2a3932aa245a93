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

from scanloom.stages.stereo.epipolar import fundamental, off_line
from scanloom.stages.stereo.posed_views import PosedView

_CORNERS = 1000
# Minimum image side, px: ORB patches are 31 px wide.
_SMALLEST_PX = 32
# Maximum Hamming distance of ORB descriptors (of 256 bits) for the same point.
_SAME_CORNER = 40
# Maximum epipolar distance relative to the image diagonal: 1.6 px for 640×480.
_TOLERANCE = 0.002
# Images are rotated if at least this number of matches fit after rotation, and this factor more than before.
_ENOUGH = 40
_FACTOR = 1.25


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of an image.

    Attributes
    ----------
    points : (n, 2) float64 pixels.
    descriptors : n ORB descriptors, or None.
    """

    points: NDArray[np.float64]
    descriptors: Any


@dataclass(frozen=True, eq=False)
class _Fit:
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
    def differ(self) -> bool:
        """Return True if the images are rotated relative to each other."""
        return self._differing > self._alike

    @property
    def evidence(self) -> int:
        """Return the margin of inliers for the decision of `differ`."""
        return abs(self._differing - self._alike)

    @property
    def _alike(self) -> int:
        return int(max(self.counts[0, 0], self.counts[1, 1]))

    @property
    def _differing(self) -> int:
        return int(max(self.counts[0, 1], self.counts[1, 0]))


def corners(grey: NDArray[np.uint8]) -> Corners:
    """Detect the corners of an image (h, w)."""
    import cv2

    if min(grey.shape) < _SMALLEST_PX:
        return Corners(np.empty((0, 2)), None)
    found, descriptors = cv2.ORB.create(_CORNERS).detectAndCompute(grey, None)
    return Corners(np.array([one.pt for one in found], np.float64).reshape(-1, 2), descriptors)


def turned(
    views: Sequence[PosedView], found: Sequence[Corners | None], pairs: Sequence[tuple[int, int]]
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
            fits.append(_Fit(first, second, _counts(views[first], views[second], here, there)))
    fits.sort(key=lambda fit: -fit.evidence)
    group, parity = _grouped(len(views), fits)
    result = [False] * len(views)
    for name in sorted(set(group)):
        inside = [fit for fit in fits if group[fit.first] == name]
        totals = [sum(_fitting(fit, parity, flip) for fit in inside) for flip in (False, True)]
        flip = totals[1] > totals[0]
        members = [at for at in range(len(views)) if group[at] == name and parity[at] != flip]
        about = [fit for fit in inside if {fit.first, fit.second} & set(members)]
        as_turned = sum(_fitting(fit, parity, flip) for fit in about)
        as_given = sum(int(fit.counts[0, 0]) for fit in about)
        if as_turned >= max(_ENOUGH, _FACTOR * as_given):
            for at in members:
                result[at] = True
    return result


def _fitting(fit: _Fit, parity: Sequence[bool], flip: bool) -> int:
    return int(fit.counts[int(parity[fit.first] != flip), int(parity[fit.second] != flip)])


def _grouped(count: int, fits: Sequence[_Fit]) -> tuple[list[int], list[bool]]:
    """Group views that are linked by matches.

    Links are merged in order of evidence. Links within a group are ignored.

    Returns
    -------
    The group of each view, and for each view True if it is rotated relative to the first view of the group.
    """
    group, parity = list(range(count)), [False] * count
    for fit in fits:
        kept, joined = group[fit.first], group[fit.second]
        if kept == joined or fit.evidence == 0:
            continue
        change = parity[fit.first] ^ parity[fit.second] ^ fit.differ
        for at in range(count):
            if group[at] == joined:
                group[at], parity[at] = kept, parity[at] ^ change
    return group, parity


def _counts(first: PosedView, second: PosedView, here: Corners, there: Corners) -> NDArray[np.int64]:
    import cv2

    counts = np.zeros((2, 2), np.int64)
    if here.descriptors is None or there.descriptors is None:
        return counts
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(here.descriptors, there.descriptors)
    same = [(one.queryIdx, one.trainIdx) for one in matches if one.distance < _SAME_CORNER]
    if not same:
        return counts
    at = np.array(same)
    sides = (_both_ways(here.points[at[:, 0]], first), _both_ways(there.points[at[:, 1]], second))
    lines = fundamental(first, second)
    limit = _TOLERANCE * float(np.hypot(second.camera.width, second.camera.height))
    for a, one in enumerate(sides[0]):
        for b, other in enumerate(sides[1]):
            counts[a, b] = np.count_nonzero(off_line(lines, one, other) <= limit)
    return counts


def _both_ways(
    points: NDArray[np.float64], view: PosedView
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (n, 2) unchanged, and rotated about the image centre.

    The rotation is 180°.
    """
    return points, np.array((view.camera.width - 1, view.camera.height - 1)) - points
