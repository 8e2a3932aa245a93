"""Agreement of colour, depth and poses, measured on a few frame pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, is_rigid
from scanloom.stages.adjusting.matching import GAP_SHARE, errors, gaps, match
from scanloom.stages.adjusting.partners import overlap_of
from scanloom.stages.adjusting.view import View, view_or_none
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Frame, Pose, SkippedFrame

# Number of sampled frames, and minimum overlap ratio of a partner. The partner of a frame is the frame with
# the median overlap among all frames above this minimum.
_LOOKS, _OVERLAP = 8, 0.8
# Minimum number of matches for a measurement. With a lower ratio of consistent matches than this, poses and
# depth do not belong together.
_LEAST, _LEAST_NEAR = 60, 0.5


@dataclass(frozen=True, eq=False)
class Look:
    """Agreement of colour, depth and poses on a few frame pairs.

    Attributes
    ----------
    views : readable views by frame index.
    skipped : unusable frames, with reasons.
    matches : number of matches between the frames of the pairs.
    errors : (n,) transfer errors of the consistent matches, pixels.
    near_share : ratio of consistent matches among matches with depth in both views; NaN without depth.
    """

    views: Mapping[int, View]
    skipped: tuple[SkippedFrame, ...]
    matches: int
    errors: NDArray[np.float64]
    near_share: float

    @property
    def median(self) -> float:
        """Return the median transfer error, pixels."""
        return float(np.median(self.errors))

    @property
    def is_of_another(self) -> bool:
        """Return True if there are enough matches, but few agree in 3-D."""
        return self.matches >= _LEAST and self.near_share < _LEAST_NEAR

    @property
    def trouble(self) -> str:
        """Return why agreement is unknown, as a clause; empty if it was measured."""
        if not self.views:
            return "none of the sampled frames can be read"
        if self.matches < _LEAST:
            return f"only {self.matches} keypoints match between frames"
        if np.isnan(self.near_share):
            return "no matched keypoint has depth"
        if self.is_of_another:
            return (
                f"only {self.near_share:.0%} of {self.matches} keypoint matches agree in 3-D; poses, depth "
                "or colour belong to another scan"
            )
        return ""


def usable(frames: Sequence[Frame]) -> list[int]:
    """List the indices of frames with colour, depth and a rigid pose."""
    return [
        place
        for place, frame in enumerate(frames)
        if frame.color is not None and frame.depth is not None and is_rigid(frame.world_from_camera)
    ]


def look(frames: Sequence[Frame], places: Sequence[int]) -> Look:
    """Measure agreement of colour, depth and poses on a few frame pairs.

    Parameters
    ----------
    frames : frames of the scan.
    places : indices of the frames with colour, depth and a pose.
    """
    poses = np.stack([_pose(frames[place]) for place in places])
    chosen = sample_evenly(len(places), _LOOKS)
    skipped: list[SkippedFrame] = []
    views = _read(frames, [places[n] for n in chosen], skipped)
    wanted = {}
    for n in chosen:
        if places[n] in views:
            shares = overlap_of(views[places[n]], poses[n], poses)
            shares[n] = 0
            enough = np.flatnonzero(shares >= _OVERLAP)
            enough = enough[np.argsort(shares[enough], kind="stable")]
            wanted[n] = int(enough[len(enough) // 2] if len(enough) else np.argmax(shares))
    others = sorted({places[n] for n in wanted.values()} - set(views))
    views |= _read(frames, others, skipped)
    order = sorted(views)
    number = {place: i for i, place in enumerate(order)}
    couples = sorted(
        {
            (number[places[a]], number[places[b]])
            for a, b in wanted.items()
            if a != b and places[a] in number and places[b] in number
        }
    )
    seen = [views[place] for place in order]
    if not couples:
        return Look(views, tuple(skipped), 0, np.zeros(0), np.nan)
    cameras = Cameras.given([frames[place] for place in order], [view.lens for view in seen])
    found = match(seen, couples)
    gap = gaps(seen, cameras, found)
    near = gap < GAP_SHARE
    off = errors(seen, cameras, found.take(near))
    share = float(near[~np.isnan(gap)].mean()) if (~np.isnan(gap)).any() else np.nan
    return Look(views, tuple(skipped), len(found), off[~np.isnan(off)], share)


def _read(frames: Sequence[Frame], places: Sequence[int], skipped: list[SkippedFrame]) -> dict[int, View]:
    views = {}
    threads = workers()
    for place, view in zip(
        places,
        read_ahead(lambda place: view_or_none(frames[place]), places, threads=threads, ahead=threads + 2),
        strict=True,
    ):
        if isinstance(view, View):
            views[place] = view
        else:
            skipped.append(view)
    return views


def _pose(frame: Frame) -> Pose:
    return np.eye(4) if frame.world_from_camera is None else np.asarray(frame.world_from_camera, np.float64)
