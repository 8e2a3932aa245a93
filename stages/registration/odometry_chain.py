"""Frame-to-frame odometry, and selection of key frames."""

from __future__ import annotations

import itertools
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.progress import Progress
from scanloom.stages.registration.features import Features
from scanloom.stages.registration.motion import (
    AlignmentFailure,
    Motion,
    align_surfaces,
    compute_rotation_angle,
    estimate_motion,
    is_negligible,
    refine_motion,
)
from scanloom.stages.registration.pose_graph import PoseGraphEdge
from scanloom.stages.registration.view import RegistrationView, read_registration_view
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, Pose, SkippedFrame

# Thresholds for a new key frame, relative to the last one: translation in median depths, rotation in radians,
# number of frames.
_KEY_SHIFT_RATIO = 0.08
_KEY_ROTATION_RAD = np.radians(8)
_KEY_INTERVAL = 10
# Maximum number of views whose images stay in memory, 0.3 MB each; others are read again on demand.
_MAX_HELD_VIEWS = 256


class KeyFrameCache:
    """Cache of key-frame views by frame index; thread-safe.

    All features stay in memory. Images stay for the most recently used views only.
    """

    def __init__(self, frames: Sequence[Frame], max_depth: float) -> None:
        self.features: dict[int, Features] = {}
        self._frames = frames
        self._max_depth = max_depth
        self._held: OrderedDict[int, RegistrationView] = OrderedDict()
        self._lock = Lock()

    def store(self, frame_index: int, view: RegistrationView) -> None:
        """Store the view of a key frame; drop the least recently used view."""
        with self._lock:
            self.features[frame_index] = view.features
            self._held[frame_index] = view
            self._held.move_to_end(frame_index)
            if len(self._held) > _MAX_HELD_VIEWS:
                self._held.popitem(last=False)

    def get_view(self, frame_index: int) -> RegistrationView:
        """Return the view of a key frame; dropped images are read again."""
        with self._lock:
            view = self._held.get(frame_index)
            if view is not None:
                self._held.move_to_end(frame_index)
                return view
        view = read_registration_view(self._frames[frame_index], self._max_depth, self.features[frame_index])
        self.store(frame_index, view)
        return view


@dataclass(frozen=True)
class ViewSummary:
    """Values that stay after the images of a view are dropped.

    Attributes
    ----------
    depth_m : median depth, metres.
    mean_color : mean grey level, 0 to 255; NaN without colour.
    """

    depth_m: float
    mean_color: float


@dataclass(frozen=True, eq=False)
class OdometryChain:
    """Usable frames with their frame-to-frame motions.

    Attributes
    ----------
    views : views of the key frames.
    summaries : values of all usable frames by frame index, in order.
    motions : target_from_source by frame index: the frame is the target, the next usable frame the source.
    poses : world_from_camera along the chain by frame index; the identity after a break.
    key_indices : frame indices of the key frames, in order.
    skipped : unusable frames, with reasons.
    """

    views: KeyFrameCache
    summaries: dict[int, ViewSummary] = field(default_factory=dict)
    motions: dict[int, Motion | AlignmentFailure] = field(default_factory=dict)
    poses: dict[int, Pose] = field(default_factory=dict)
    key_indices: list[int] = field(default_factory=list)
    skipped: list[SkippedFrame] = field(default_factory=list)

    @property
    def break_indices(self) -> list[int]:
        """Return the frame indices after which the chain is broken, in order."""
        return [number for number, motion in self.motions.items() if isinstance(motion, AlignmentFailure)]


def build_odometry_chain(
    frames: Sequence[Frame], max_depth: float, progress: Progress, initial_poses: Mapping[int, Pose]
) -> OdometryChain:
    """Align each frame to its predecessor, and select key frames.

    Parameters
    ----------
    frames : frames in recording order.
    max_depth : farther depth is ignored, metres.
    initial_poses : world_from_camera by frame index: initial guesses, kept if no better motion is found.
    """
    threads = get_worker_count()
    chain = OdometryChain(KeyFrameCache(frames, max_depth))

    def read(frame: Frame) -> RegistrationView | SkippedFrame:
        try:
            return read_registration_view(frame, max_depth)
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))

    def iterate_pairs() -> Iterator[tuple[int, RegistrationView, int, RegistrationView]]:
        before: tuple[int, RegistrationView] | None = None
        for number, view in enumerate(map_ordered(read, frames, threads=threads, max_pending=threads + 2)):
            if isinstance(view, SkippedFrame):
                chain.skipped.append(view)
                continue
            chain.summaries[number] = ViewSummary(view.depth_m, view.mean_color)
            if before is None:
                chain.poses[number] = np.eye(4)
                _add_key_frame(chain, number, view)
            else:
                yield *before, number, view
            before = number, view

    def align_pair(
        couple: tuple[int, RegistrationView, int, RegistrationView],
    ) -> tuple[int, RegistrationView, int, RegistrationView, Motion | AlignmentFailure]:
        before, target, number, source = couple
        # The motion is that from the later to the earlier frame, so that poses are products from left to
        # right.
        if before in initial_poses and number in initial_poses:
            guess = invert_pose(initial_poses[before]) @ initial_poses[number]
            return *couple, refine_motion(source, target, max_depth, guess)
        return *couple, estimate_motion(source, target, max_depth)

    last: Motion | AlignmentFailure | None = None
    for before, target, number, source, found in map_ordered(
        align_pair, iterate_pairs(), threads=threads, max_pending=threads + 2
    ):
        is_given = before in initial_poses and number in initial_poses
        if (
            not is_given
            and isinstance(last, Motion)
            and (isinstance(found, AlignmentFailure) or found.inlier_count == 0)
        ):
            # Nothing was matched: the previous motion (constant velocity) serves as initial guess.
            again = align_surfaces(source, target, max_depth, last.target_from_source)
            if isinstance(again, Motion):
                found = again if isinstance(found, AlignmentFailure) else max(found, again, key=_get_fitness)
        _append_frame(chain, before, target, number, source, found)
        last = found
        progress(number + 1, len(frames))
    if len(chain.summaries) > 1 and chain.key_indices[-1] != number:
        _add_key_frame(chain, number, source)
    return chain


def align_key_frames(chain: OdometryChain, max_depth: float) -> Iterator[PoseGraphEdge]:
    """Yield the motions between consecutive key frames, aligned directly if possible.

    Each alignment underestimates the motion a little, because depth noise holds surfaces in place. A single
    alignment over many frames loses less than a product of many alignments.
    """

    def align_edge(edge: PoseGraphEdge) -> PoseGraphEdge:
        a, b = chain.key_indices[edge.target], chain.key_indices[edge.source]
        if chain.motions[a] is edge.motion:
            return edge
        source = chain.views.get_view(b)
        motion = estimate_motion(source, chain.views.get_view(a), max_depth, edge.motion.target_from_source)
        if isinstance(motion, AlignmentFailure) or motion.has_moving_part:
            return edge
        off = invert_pose(edge.motion.target_from_source) @ motion.target_from_source
        return replace(edge, motion=motion) if is_negligible(off, source.depth_m) else edge

    threads = get_worker_count()
    yield from map_ordered(align_edge, _iterate_chain_edges(chain), threads=threads, max_pending=threads + 2)


def _append_frame(
    chain: OdometryChain,
    previous_index: int,
    target: RegistrationView,
    frame_index: int,
    source: RegistrationView,
    motion: Motion | AlignmentFailure,
) -> None:
    """Append a frame to the chain, as a key frame if due."""
    chain.motions[previous_index] = motion
    if isinstance(motion, AlignmentFailure):
        # The last frame before a break becomes a key frame, because later frames match it best when the
        # camera returns.
        if chain.key_indices[-1] != previous_index:
            _add_key_frame(chain, previous_index, target)
        chain.poses[frame_index] = np.eye(4)
        _add_key_frame(chain, frame_index, source)
        return
    chain.poses[frame_index] = chain.poses[previous_index] @ motion.target_from_source
    moved = invert_pose(chain.poses[chain.key_indices[-1]]) @ chain.poses[frame_index]
    far = np.linalg.norm(moved[:3, 3]) > _KEY_SHIFT_RATIO * source.depth_m
    if (
        far
        or compute_rotation_angle(moved) > _KEY_ROTATION_RAD
        or frame_index - chain.key_indices[-1] >= _KEY_INTERVAL
    ):
        _add_key_frame(chain, frame_index, source)


def _get_fitness(motion: Motion) -> float:
    return motion.fitness


def _add_key_frame(chain: OdometryChain, frame_index: int, view: RegistrationView) -> None:
    chain.key_indices.append(frame_index)
    chain.views.store(frame_index, view)


def _iterate_chain_edges(chain: OdometryChain) -> Iterator[PoseGraphEdge]:
    """Yield the motions between consecutive key frames as products along the chain."""
    numbers = list(chain.motions)
    for later, (a, b) in enumerate(itertools.pairwise(chain.key_indices), 1):
        between = [chain.motions[n] for n in numbers[bisect_left(numbers, a) : bisect_left(numbers, b)]]
        motions = [motion for motion in between if isinstance(motion, Motion)]
        if len(motions) < len(between):
            continue
        yield PoseGraphEdge(later, later - 1, _compose_motions(chain, a, b, motions), is_certain=True)


def _compose_motions(chain: OdometryChain, a: int, b: int, motions: Sequence[Motion]) -> Motion:
    if len(motions) == 1:
        return motions[0]
    weakest = min(motions, key=lambda motion: motion.fitness)
    return Motion(
        invert_pose(chain.poses[a]) @ chain.poses[b],
        weakest.information / len(motions),
        weakest.fitness,
        max((motion.rmse_m for motion in motions if motion.rmse_m is not None), default=None),
        min(motion.inlier_count for motion in motions),
        any(motion.has_moving_part for motion in motions),
    )
