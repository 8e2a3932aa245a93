"""Agreement of colour, depth and poses, measured on a few frame pairs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, is_rigid
from scanloom.stages.adjusting.matching import (
    MAX_GAP_RATIO,
    compute_match_errors,
    compute_point_gaps,
    match_views,
)
from scanloom.stages.adjusting.view import AdjustmentView, read_view_or_reason
from scanloom.stages.adjusting.view_pairs import compute_view_overlap
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, Pose, SkippedFrame

# Number of sampled frames, and minimum overlap ratio of a partner. The partner of a frame is the frame with
# the median overlap among all frames above this minimum.
_SAMPLE_COUNT, _MIN_OVERLAP_RATIO = 8, 0.8
# Minimum number of matches for a measurement. With a lower ratio of consistent matches than this, poses and
# depth do not belong together.
_MIN_MATCHES, _MIN_CONSISTENT_RATIO = 60, 0.5


@dataclass(frozen=True, eq=False)
class AgreementSample:
    """Agreement of colour, depth and poses on a few frame pairs.

    Attributes
    ----------
    views : readable views by frame index.
    skipped : unusable frames, with reasons.
    match_count : number of matches between the frames of the pairs.
    errors : (n,) transfer errors of the consistent matches, pixels.
    consistent_ratio : ratio of consistent matches among matches with depth in both views; NaN without depth.
    """

    views: Mapping[int, AdjustmentView]
    skipped: tuple[SkippedFrame, ...]
    match_count: int
    errors: NDArray[np.float64]
    consistent_ratio: float

    @property
    def median_px(self) -> float:
        """Return the median transfer error, pixels."""
        return float(np.median(self.errors))

    @property
    def is_inconsistent(self) -> bool:
        """Return True if there are enough matches, but few agree in 3-D."""
        return self.match_count >= _MIN_MATCHES and self.consistent_ratio < _MIN_CONSISTENT_RATIO

    @property
    def failure_reason(self) -> str:
        """Return why agreement is unknown, as a clause; empty if it was measured."""
        if not self.views:
            return "none of the sampled frames can be read"
        if self.match_count < _MIN_MATCHES:
            return f"only {self.match_count} keypoints match between frames"
        if np.isnan(self.consistent_ratio):
            return "no matched keypoint has depth"
        if self.is_inconsistent:
            return (
                f"only {self.consistent_ratio:.0%} of {self.match_count} keypoint matches agree in 3-D; "
                "poses, depth "
                "or colour belong to another scan"
            )
        return ""


def find_usable_frames(frames: Sequence[Frame]) -> list[int]:
    """List the indices of frames with colour, depth and a rigid pose."""
    return [
        place
        for place, frame in enumerate(frames)
        if frame.color is not None and frame.depth is not None and is_rigid(frame.world_from_camera)
    ]


def measure_agreement(
    frames: Sequence[Frame], frame_indices: Sequence[int], progress: Progress = ignore_progress
) -> AgreementSample:
    """Measure agreement of colour, depth and poses on a few frame pairs.

    Parameters
    ----------
    frames : frames of the scan.
    frame_indices : indices of the frames with colour, depth and a pose.
    progress : called with the number of read and matched frames, and the total.
    """
    poses = np.stack([_get_pose(frames[place]) for place in frame_indices])
    chosen = sample_evenly(len(frame_indices), _SAMPLE_COUNT)
    # Each sampled frame is read, gets a partner, and is matched with it.
    count = len(chosen)
    skipped: list[SkippedFrame] = []
    views = _read_views(
        frames, [frame_indices[n] for n in chosen], skipped, lambda done: progress(done, 3 * count)
    )
    partner_of = {}
    for n in chosen:
        if frame_indices[n] in views:
            shares = compute_view_overlap(views[frame_indices[n]], poses[n], poses)
            shares[n] = 0
            enough = np.flatnonzero(shares >= _MIN_OVERLAP_RATIO)
            enough = enough[np.argsort(shares[enough], kind="stable")]
            partner_of[n] = int(enough[len(enough) // 2] if len(enough) else np.argmax(shares))
    others = sorted({frame_indices[n] for n in partner_of.values()} - set(views))
    views |= _read_views(frames, others, skipped, lambda done: progress(count + done, 3 * count))
    order = sorted(views)
    number = {place: i for i, place in enumerate(order)}
    pairs = sorted(
        {
            (number[frame_indices[a]], number[frame_indices[b]])
            for a, b in partner_of.items()
            if a != b and frame_indices[a] in number and frame_indices[b] in number
        }
    )
    seen = [views[place] for place in order]
    if not pairs:
        return AgreementSample(views, tuple(skipped), 0, np.zeros(0), np.nan)
    cameras = Cameras.from_frames([frames[place] for place in order], [view.lens for view in seen])
    found = match_views(seen, pairs, lambda done, _: progress(2 * count + done, 3 * count))
    gap = compute_point_gaps(seen, cameras, found)
    near = gap < MAX_GAP_RATIO
    off = compute_match_errors(seen, cameras, found.select(near))
    share = float(near[~np.isnan(gap)].mean()) if (~np.isnan(gap)).any() else np.nan
    return AgreementSample(views, tuple(skipped), len(found), off[~np.isnan(off)], share)


def _read_views(
    frames: Sequence[Frame],
    frame_indices: Sequence[int],
    skipped: list[SkippedFrame],
    report_count: Callable[[int], object],
) -> dict[int, AdjustmentView]:
    views = {}
    threads = get_worker_count()
    for done, place, view in zip(
        range(1, len(frame_indices) + 1),
        frame_indices,
        map_ordered(
            lambda place: read_view_or_reason(frames[place]),
            frame_indices,
            threads=threads,
            max_pending=threads + 2,
        ),
        strict=True,
    ):
        if isinstance(view, AdjustmentView):
            views[place] = view
        else:
            skipped.append(view)
        report_count(done)
    return views


def _get_pose(frame: Frame) -> Pose:
    return np.eye(4) if frame.world_from_camera is None else np.asarray(frame.world_from_camera, np.float64)
