"""Feature tracks: keypoints matched across three or more views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.matching import Matches
from scanloom.stages.adjusting.rolling_shutter import compute_readout_times
from scanloom.stages.adjusting.view import AdjustmentView

# Minimum number of views of a track.
_MIN_VIEWS = 3


@dataclass(frozen=True, eq=False)
class Tracks:
    """n observations of p points, sorted by point.

    Attributes
    ----------
    view_indices, point_indices : (n,) indices of view and point; a view observes a point once at most.
    pixels : (n, 2) in the colour image.
    readout_times : (n,) readout times of the pixels, see stages/adjusting/rolling_shutter.py.
    point_of_match : (k,) index of the point of each match; -1 for a match without a point.
    """

    view_indices: NDArray[np.intp]
    point_indices: NDArray[np.intp]
    pixels: NDArray[np.float64]
    readout_times: NDArray[np.float64]
    point_of_match: NDArray[np.intp]

    @property
    def point_count(self) -> int:
        """Return the number of points."""
        return int(self.point_indices[-1]) + 1 if len(self.point_indices) else 0

    def select(self, mask: NDArray[np.bool_]) -> Tracks:
        """Select points by a mask (p,), and drop the indices of matches."""
        kept = mask[self.point_indices]
        _, point = np.unique(self.point_indices[kept], return_inverse=True)
        return Tracks(
            self.view_indices[kept], point, self.pixels[kept], self.readout_times[kept], np.zeros(0, np.intp)
        )


def build_tracks(views: Sequence[AdjustmentView], matches: Matches) -> Tracks:
    """Join matches into tracks.

    Tracks with two keypoints in one view contain a wrong match, and are dropped.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    starts = np.concatenate([[0], np.cumsum([len(view.pixels) for view in views])])
    nodes = starts[matches.pair_indices] + matches.keypoint_indices
    used, ends = np.unique(nodes, return_inverse=True)
    ends = ends.reshape(nodes.shape)
    edges = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(used), len(used)))
    _, label = connected_components(edges, directed=False)
    view = np.searchsorted(starts, used, side="right") - 1
    sizes = np.bincount(label, minlength=1)
    distinct = np.bincount(np.unique(label * len(views) + view) // len(views), minlength=len(sizes))
    sound = (sizes >= _MIN_VIEWS) & (sizes == distinct)
    number = np.where(sound, np.cumsum(sound) - 1, -1)
    order = np.lexsort((view, label))
    order = order[sound[label[order]]]
    at = used[order]
    pixels = np.concatenate([one.pixels for one in views]).astype(np.float64)[at]
    late = compute_readout_times(views, view[order], pixels)
    return Tracks(view[order], number[label[order]], pixels, late, number[label[ends[:, 0]]])
