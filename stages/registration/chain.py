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
from scanloom.stages.registration.graph import Edge
from scanloom.stages.registration.motion import (
    Motion,
    NoMotion,
    agree,
    angle,
    by_surface,
    motion_between,
    refined,
)
from scanloom.stages.registration.view import View, read_view
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Frame, Pose, SkippedFrame

# Thresholds for a new key frame, relative to the last one: translation in median depths, rotation in radians,
# number of frames.
_KEY_SHIFT = 0.08
_KEY_TURN = np.radians(8)
_KEY_FRAMES = 10
# Maximum number of views whose images stay in memory, 0.3 MB each; others are read again on demand.
_MAX_HELD_VIEWS = 256


class KeyViews:
    """Cache of key-frame views by frame index; thread-safe.

    All features stay in memory. Images stay for the most recently used views only.
    """

    def __init__(self, frames: Sequence[Frame], max_depth: float) -> None:
        self.features: dict[int, Features] = {}
        self._frames = frames
        self._max_depth = max_depth
        self._held: OrderedDict[int, View] = OrderedDict()
        self._lock = Lock()

    def keep(self, number: int, view: View) -> None:
        """Store the view of a key frame; drop the least recently used view."""
        with self._lock:
            self.features[number] = view.features
            self._held[number] = view
            self._held.move_to_end(number)
            if len(self._held) > _MAX_HELD_VIEWS:
                self._held.popitem(last=False)

    def view(self, number: int) -> View:
        """Return the view of a key frame; dropped images are read again."""
        with self._lock:
            view = self._held.get(number)
            if view is not None:
                self._held.move_to_end(number)
                return view
        view = read_view(self._frames[number], self._max_depth, self.features[number])
        self.keep(number, view)
        return view


@dataclass(frozen=True)
class Seen:
    """Values that stay after the images of a view are dropped.

    Attributes
    ----------
    depth_m : median depth, metres.
    mean_color : mean grey level, 0 to 255; NaN without colour.
    """

    depth_m: float
    mean_color: float


@dataclass(frozen=True, eq=False)
class Chain:
    """Usable frames with their frame-to-frame motions.

    Attributes
    ----------
    views : views of the key frames.
    seen : values of all usable frames by frame index, in order.
    motions : target_from_source by frame index: the frame is the target, the next usable frame the source.
    poses : world_from_camera along the chain by frame index; the identity after a break.
    keys : frame indices of the key frames, in order.
    skipped : unusable frames, with reasons.
    """

    views: KeyViews
    seen: dict[int, Seen] = field(default_factory=dict)
    motions: dict[int, Motion | NoMotion] = field(default_factory=dict)
    poses: dict[int, Pose] = field(default_factory=dict)
    keys: list[int] = field(default_factory=list)
    skipped: list[SkippedFrame] = field(default_factory=list)

    @property
    def breaks(self) -> list[int]:
        """Return the frame indices after which the chain is broken, in order."""
        return [number for number, motion in self.motions.items() if isinstance(motion, NoMotion)]


def make_chain(
    frames: Sequence[Frame], max_depth: float, progress: Progress, given: Mapping[int, Pose]
) -> Chain:
    """Align each frame to its predecessor, and select key frames.

    Parameters
    ----------
    frames : frames in recording order.
    max_depth : farther depth is ignored, metres.
    given : world_from_camera by frame index: initial guesses, kept if no better motion is found.
    """
    threads = workers()
    chain = Chain(KeyViews(frames, max_depth))

    def read(frame: Frame) -> View | SkippedFrame:
        try:
            return read_view(frame, max_depth)
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic.within(frame=None))

    def couples() -> Iterator[tuple[int, View, int, View]]:
        before: tuple[int, View] | None = None
        for number, view in enumerate(read_ahead(read, frames, threads=threads, ahead=threads + 2)):
            if isinstance(view, SkippedFrame):
                chain.skipped.append(view)
                continue
            chain.seen[number] = Seen(view.depth_m, view.mean_color)
            if before is None:
                chain.poses[number] = np.eye(4)
                _take(chain, number, view)
            else:
                yield *before, number, view
            before = number, view

    def place(couple: tuple[int, View, int, View]) -> tuple[int, View, int, View, Motion | NoMotion]:
        before, target, number, source = couple
        # The motion is that from the later to the earlier frame, so that poses are products from left to
        # right.
        if before in given and number in given:
            guess = inverted(given[before]) @ given[number]
            return *couple, refined(source, target, max_depth, guess)
        return *couple, motion_between(source, target, max_depth)

    last: Motion | NoMotion | None = None
    for before, target, number, source, found in read_ahead(
        place, couples(), threads=threads, ahead=threads + 2
    ):
        is_given = before in given and number in given
        if not is_given and isinstance(last, Motion) and (isinstance(found, NoMotion) or found.points == 0):
            # Nothing was matched: the previous motion (constant velocity) serves as initial guess.
            again = by_surface(source, target, max_depth, last.target_from_source)
            if isinstance(again, Motion):
                found = again if isinstance(found, NoMotion) else max(found, again, key=_fitness)
        _append(chain, before, target, number, source, found)
        last = found
        progress(number + 1, len(frames))
    if len(chain.seen) > 1 and chain.keys[-1] != number:
        _take(chain, number, source)
    return chain


def key_edges(chain: Chain, max_depth: float) -> Iterator[Edge]:
    """Yield the motions between consecutive key frames, aligned directly if possible.

    Each alignment underestimates the motion a little, because depth noise holds surfaces in place. A single
    alignment over many frames loses less than a product of many alignments.
    """

    def place(edge: Edge) -> Edge:
        a, b = chain.keys[edge.target], chain.keys[edge.source]
        if chain.motions[a] is edge.motion:
            return edge
        source = chain.views.view(b)
        motion = motion_between(source, chain.views.view(a), max_depth, edge.motion.target_from_source)
        if isinstance(motion, NoMotion) or motion.is_split:
            return edge
        off = inverted(edge.motion.target_from_source) @ motion.target_from_source
        return replace(edge, motion=motion) if agree(off, source.depth_m) else edge

    threads = workers()
    yield from read_ahead(place, _chain_edges(chain), threads=threads, ahead=threads + 2)


def _append(
    chain: Chain, before: int, target: View, number: int, source: View, motion: Motion | NoMotion
) -> None:
    """Append a frame to the chain, as a key frame if due."""
    chain.motions[before] = motion
    if isinstance(motion, NoMotion):
        # The last frame before a break becomes a key frame, because later frames match it best when the
        # camera returns.
        if chain.keys[-1] != before:
            _take(chain, before, target)
        chain.poses[number] = np.eye(4)
        _take(chain, number, source)
        return
    chain.poses[number] = chain.poses[before] @ motion.target_from_source
    moved = inverted(chain.poses[chain.keys[-1]]) @ chain.poses[number]
    far = np.linalg.norm(moved[:3, 3]) > _KEY_SHIFT * source.depth_m
    if far or angle(moved) > _KEY_TURN or number - chain.keys[-1] >= _KEY_FRAMES:
        _take(chain, number, source)


def _fitness(motion: Motion) -> float:
    return motion.fitness


def _take(chain: Chain, number: int, view: View) -> None:
    chain.keys.append(number)
    chain.views.keep(number, view)


def _chain_edges(chain: Chain) -> Iterator[Edge]:
    """Yield the motions between consecutive key frames as products along the chain."""
    numbers = list(chain.motions)
    for later, (a, b) in enumerate(itertools.pairwise(chain.keys), 1):
        between = [chain.motions[n] for n in numbers[bisect_left(numbers, a) : bisect_left(numbers, b)]]
        motions = [motion for motion in between if isinstance(motion, Motion)]
        if len(motions) < len(between):
            continue
        yield Edge(later, later - 1, _put_together(chain, a, b, motions), is_certain=True)


def _put_together(chain: Chain, a: int, b: int, motions: Sequence[Motion]) -> Motion:
    if len(motions) == 1:
        return motions[0]
    weakest = min(motions, key=lambda motion: motion.fitness)
    return Motion(
        inverted(chain.poses[a]) @ chain.poses[b],
        weakest.information / len(motions),
        weakest.fitness,
        max((motion.rmse_m for motion in motions if motion.rmse_m is not None), default=None),
        min(motion.points for motion in motions),
        any(motion.is_split for motion in motions),
    )
