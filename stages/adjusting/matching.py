"""Keypoint matches between frame pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras
from scanloom.stages.adjusting.lens import rays
from scanloom.stages.adjusting.lifting import in_world, lifted, transfer_errors
from scanloom.stages.adjusting.shutter import late_of
from scanloom.stages.adjusting.view import View
from scanloom.stages.frames.features import find_epipolar_inliers, match_descriptors
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.prefetch import read_ahead, workers

# Maximum distance between the two unprojected points of a consistent match, relative to their depth.
GAP_SHARE = 0.13


@dataclass(frozen=True, eq=False)
class Matches:
    """n keypoint matches between views.

    Attributes
    ----------
    couples : (n, 2) indices of the two views.
    points : (n, 2) indices of the keypoints in these views.
    """

    couples: NDArray[np.intp]
    points: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.couples)

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Matches:
        """Select matches by mask or indices."""
        return Matches(self.couples[which], self.points[which])

    def pixels(self, views: Sequence[View]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the pixels (n, 2) of the matches in their first and second views."""
        starts = np.concatenate([[0], np.cumsum([len(view.pixels) for view in views])])
        pixels = np.concatenate([view.pixels for view in views]).astype(np.float64)
        places = starts[self.couples] + self.points
        return pixels[places[:, 0]], pixels[places[:, 1]]


def match(views: Sequence[View], couples: Sequence[tuple[int, int]], progress: Progress = silent) -> Matches:
    """Match keypoints of frame pairs, and keep epipolar inliers.

    Parameters
    ----------
    views : views with keypoints.
    couples : indices of the two views of each pair.
    progress : called with the number of finished pairs and of all pairs.
    """
    threads = workers()

    def of(couple: tuple[int, int]) -> NDArray[np.int64]:
        a, b = (views[number] for number in couple)
        return _agreeing(a, b, match_descriptors(a.descriptors, b.descriptors))

    which, pairs = [np.zeros((0, 2), int)], [np.zeros((0, 2), int)]
    for done, (couple, found) in enumerate(
        zip(couples, read_ahead(of, couples, threads=threads, ahead=2 * threads), strict=True), 1
    ):
        which.append(np.tile(couple, (len(found), 1)))
        pairs.append(found)
        progress(done, len(couples))
    return Matches(np.concatenate(which).astype(np.intp), np.concatenate(pairs).astype(np.intp))


def _agreeing(a: View, b: View, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Keep the matches that agree with one fundamental matrix.

    Pixels are undistorted first.
    """
    first, second = (
        (rays(one.pixels[pairs[:, side]], one.lens)[:, :2] * one.lens[:2] + one.lens[2:4]).astype(np.float32)
        for side, one in enumerate((a, b))
    )
    return pairs[find_epipolar_inliers(first, second)]


def gaps(views: Sequence[View], cameras: Cameras, found: Matches) -> NDArray[np.float64]:
    """Compute the distance between the two unprojected points of each match.

    Returns
    -------
    (n,) relative to the smaller depth of both; NaN if a view has no depth there.
    """
    both = list(zip(found.couples.T, found.pixels(views), strict=True))
    seen = [lifted(views, cameras, view, pixels) for view, pixels in both]
    places = [
        in_world(cameras, view, points, late_of(views, view, pixels))
        for (view, pixels), points in zip(both, seen, strict=True)
    ]
    gap = np.linalg.norm(places[0] - places[1], axis=1)
    return np.asarray(gap / np.minimum(seen[0][:, 2], seen[1][:, 2]))


def errors(views: Sequence[View], cameras: Cameras, found: Matches) -> NDArray[np.float64]:
    """Compute the transfer errors (n,) of matches in pixels, see `transfer_errors`."""
    return transfer_errors(views, cameras, found.couples, found.pixels(views))
