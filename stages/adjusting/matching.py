"""Keypoint matches between frame pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras
from scanloom.stages.adjusting.lens import compute_rays
from scanloom.stages.adjusting.rolling_shutter import compute_readout_times
from scanloom.stages.adjusting.unprojection import (
    compute_transfer_errors,
    transform_to_world,
    unproject_pixels,
)
from scanloom.stages.adjusting.view import AdjustmentView
from scanloom.stages.frames.features import find_epipolar_inliers, match_descriptors
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered

# Maximum distance between the two unprojected points of a consistent match, relative to their depth.
MAX_GAP_RATIO = 0.13


@dataclass(frozen=True, eq=False)
class Matches:
    """n keypoint matches between views.

    Attributes
    ----------
    pair_indices : (n, 2) indices of the two views.
    keypoint_indices : (n, 2) indices of the keypoints in these views.
    """

    pair_indices: NDArray[np.intp]
    keypoint_indices: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.pair_indices)

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Matches:
        """Select matches by mask or indices."""
        return Matches(self.pair_indices[chosen], self.keypoint_indices[chosen])

    def get_pixels(self, views: Sequence[AdjustmentView]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the pixels (n, 2) of the matches in their first and second views."""
        starts = np.concatenate([[0], np.cumsum([len(view.pixels) for view in views])])
        pixels = np.concatenate([view.pixels for view in views]).astype(np.float64)
        places = starts[self.pair_indices] + self.keypoint_indices
        return pixels[places[:, 0]], pixels[places[:, 1]]


def match_views(
    views: Sequence[AdjustmentView],
    pair_indices: Sequence[tuple[int, int]],
    progress: Progress = ignore_progress,
) -> Matches:
    """Match keypoints of frame pairs, and keep epipolar inliers.

    Parameters
    ----------
    views : views with keypoints.
    pair_indices : indices of the two views of each pair.
    progress : called with the number of finished pairs and of all pairs.
    """
    threads = get_worker_count()

    def match_pair(couple: tuple[int, int]) -> NDArray[np.int64]:
        a, b = (views[number] for number in couple)
        return _keep_epipolar_inliers(a, b, match_descriptors(a.descriptors, b.descriptors))

    which, pairs = [np.zeros((0, 2), int)], [np.zeros((0, 2), int)]
    for done, (couple, found) in enumerate(
        zip(
            pair_indices,
            map_ordered(match_pair, pair_indices, threads=threads, max_pending=2 * threads),
            strict=True,
        ),
        1,
    ):
        which.append(np.tile(couple, (len(found), 1)))
        pairs.append(found)
        progress(done, len(pair_indices))
    return Matches(np.concatenate(which).astype(np.intp), np.concatenate(pairs).astype(np.intp))


def _keep_epipolar_inliers(
    a: AdjustmentView, b: AdjustmentView, pairs: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Keep the matches that agree with one fundamental matrix.

    Pixels are undistorted first.
    """
    first, second = (
        (compute_rays(one.pixels[pairs[:, side]], one.lens)[:, :2] * one.lens[:2] + one.lens[2:4]).astype(
            np.float32
        )
        for side, one in enumerate((a, b))
    )
    return pairs[find_epipolar_inliers(first, second)]


def compute_point_gaps(
    views: Sequence[AdjustmentView], cameras: Cameras, matches: Matches
) -> NDArray[np.float64]:
    """Compute the distance between the two unprojected points of each match.

    Returns
    -------
    (n,) relative to the smaller depth of both; NaN if a view has no depth there.
    """
    both = list(zip(matches.pair_indices.T, matches.get_pixels(views), strict=True))
    seen = [unproject_pixels(views, cameras, view, pixels) for view, pixels in both]
    places = [
        transform_to_world(cameras, view, points, compute_readout_times(views, view, pixels))
        for (view, pixels), points in zip(both, seen, strict=True)
    ]
    gap = np.linalg.norm(places[0] - places[1], axis=1)
    return np.asarray(gap / np.minimum(seen[0][:, 2], seen[1][:, 2]))


def compute_match_errors(
    views: Sequence[AdjustmentView], cameras: Cameras, matches: Matches
) -> NDArray[np.float64]:
    """Compute the transfer errors (n,) of matches in pixels, see `compute_transfer_errors`."""
    return compute_transfer_errors(views, cameras, matches.pair_indices, matches.get_pixels(views))
