"""Find images that were turned upside down after their cameras were calibrated.

Whoever collects views of an object likes them the right way up; the poses then belong to other images.
Corners that are found in two images tell: they lie on each other's epipolar lines only if both images are as
their poses say. Two images that are both turned nearly fit as well, so that the views are judged together.
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
# A corner and its surroundings need 31 px.
_SMALLEST_PX = 32
# Corners differ in no more bits of 256 when they are the same point.
_SAME_CORNER = 40
# Share of the image's diagonal that a corner may be off its epipolar line: 1.6 px of 640×480.
_TOLERANCE = 0.002
# Images count as turned when so many corners fit then, and by this factor more than without.
_ENOUGH = 40
_FACTOR = 1.25


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of an image: (n, 2) float64 pixels, and n descriptors or None."""

    points: NDArray[np.float64]
    descriptors: Any


@dataclass(frozen=True, eq=False)
class _Fit:
    """How many corners of two views fit: `counts[a, b]`, the first turned if a is 1, the second if b is."""

    first: int
    second: int
    counts: NDArray[np.int64]

    @property
    def differ(self) -> bool:
        """Return whether one of the two is turned against the other."""
        return self._differing > self._alike

    @property
    def evidence(self) -> int:
        """Return by how many corners that is so, or is not."""
        return abs(self._differing - self._alike)

    @property
    def _alike(self) -> int:
        return int(max(self.counts[0, 0], self.counts[1, 1]))

    @property
    def _differing(self) -> int:
        return int(max(self.counts[0, 1], self.counts[1, 0]))


def corners(grey: NDArray[np.uint8]) -> Corners:
    """Return the corners of an (h, w) image."""
    import cv2

    if min(grey.shape) < _SMALLEST_PX:
        return Corners(np.empty((0, 2)), None)
    found, descriptors = cv2.ORB.create(_CORNERS).detectAndCompute(grey, None)
    return Corners(np.array([one.pt for one in found], np.float64).reshape(-1, 2), descriptors)


def turned(
    views: Sequence[PosedView], found: Sequence[Corners | None], pairs: Sequence[tuple[int, int]]
) -> list[bool]:
    """Return for each view whether its image is turned by 180 degrees against its pose.

    Parameters
    ----------
    found : the corners of each view's image; None where it could not be read.
    pairs : places of views that see the same.
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
    """Return the group of each view that others are linked to, and whether it is turned against its first.

    The surest links are made first; what they settle is not asked again.
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
    """Return points (n, 2) as they are and turned about the middle of the image."""
    return points, np.array((view.camera.width - 1, view.camera.height - 1)) - points
