"""The chain: every frame placed to the one before, and the key frames that stand for it."""

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

# A key frame is taken where the view has moved by this much of its median depth, has turned by this much, or
# after so many frames.
_KEY_SHIFT = 0.08
_KEY_TURN = np.radians(8)
_KEY_FRAMES = 10
# Views whose images are kept, of 0.3 MB each; others are read again when they are asked for.
_MAX_HELD_VIEWS = 256


class KeyViews:
    """Views of key frames by their index in the scan. Safe to use from any thread.

    All features stay in memory; images stay as long as there is room.
    """

    def __init__(self, frames: Sequence[Frame], max_depth: float) -> None:
        self.features: dict[int, Features] = {}
        self._frames = frames
        self._max_depth = max_depth
        self._held: OrderedDict[int, View] = OrderedDict()
        self._lock = Lock()

    def keep(self, number: int, view: View) -> None:
        """Store the view of a key frame, and drop the least recently used one if too many are held."""
        with self._lock:
            self.features[number] = view.features
            self._held[number] = view
            self._held.move_to_end(number)
            if len(self._held) > _MAX_HELD_VIEWS:
                self._held.popitem(last=False)

    def view(self, number: int) -> View:
        """Return a stored view; images that were dropped are read again."""
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
    """What is kept of a view once its images are gone."""

    depth_m: float
    mean_color: float


@dataclass(frozen=True, eq=False)
class Chain:
    """Frames that can be used, and the motion of each to the next one that can.

    Attributes
    ----------
    views : of the key frames.
    seen : by the frame's place in the scan, in order; of all frames that can be used.
    motions : of the next frame that can be used to the one of this place.
    poses : world_from_camera along the chain; after a break they start anew.
    keys : places of the key frames, in order.
    """

    views: KeyViews
    seen: dict[int, Seen] = field(default_factory=dict)
    motions: dict[int, Motion | NoMotion] = field(default_factory=dict)
    poses: dict[int, Pose] = field(default_factory=dict)
    keys: list[int] = field(default_factory=list)
    skipped: list[SkippedFrame] = field(default_factory=list)

    @property
    def breaks(self) -> list[int]:
        """Return the places after which the chain is broken, in order."""
        return [number for number, motion in self.motions.items() if isinstance(motion, NoMotion)]


def make_chain(
    frames: Sequence[Frame], max_depth: float, progress: Progress, given: Mapping[int, Pose]
) -> Chain:
    """Read all frames, place each to the one before, and choose key frames.

    Parameters
    ----------
    given : world_from_camera of frames by their place: first guesses, and kept where no better is found.
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
        # The motion of the later one to the earlier, so that poses are products from left to right.
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
            # Nothing was recognised: a camera in motion goes on as it went.
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
    """Yield the motions between key frames that follow each other, found at once where that works.

    Every alignment comes out a little short, since noise holds a surface where it is: one over many frames is
    less short than many put together.
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
    """Put a frame at the end of the chain, as a key frame if it is one."""
    chain.motions[before] = motion
    if isinstance(motion, NoMotion):
        # The last one before a break too: it is the one most like what may come back.
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
    """Yield the motions between key frames that follow each other, put together from those between."""
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
