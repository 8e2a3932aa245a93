"""The chain: every frame placed to the one before, and the key frames that stand for it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stages.errors import InputError
from stages.formats.trajectories import inverted
from stages.prefetch import read_ahead, workers
from stages.progress import Progress
from stages.registration.features import Features
from stages.registration.graph import Edge
from stages.registration.motion import Motion, NoMotion, agree, angle, motion_between
from stages.registration.view import View, read_view
from stages.scan import Frame, Pose, SkippedFrame

# A key frame is taken where the view has moved by this much of its median depth, has turned by this much, or
# after so many frames.
_KEY_SHIFT = 0.08
_KEY_TURN = np.radians(8)
_KEY_FRAMES = 10


@dataclass(frozen=True, eq=False)
class Seen:
    """What is kept of a view once its images are gone."""

    features: Features
    depth_m: float
    mean_color: float


@dataclass(frozen=True, eq=False)
class Chain:
    """Frames that can be used, and the motion of each to the next one that can."""

    seen: dict[int, Seen]
    motions: dict[int, Motion | NoMotion]
    skipped: list[SkippedFrame]

    @property
    def numbers(self) -> list[int]:
        """Return the places in the scan of the frames that can be used."""
        return sorted(self.seen)


def make_chain(frames: Sequence[Frame], max_depth: float, progress: Progress) -> Chain:
    """Read all frames, and place each to the one before."""
    threads = workers()
    chain = Chain({}, {}, [])

    def read(frame: Frame) -> View | SkippedFrame:
        try:
            return read_view(frame, max_depth)
        except InputError as error:
            return SkippedFrame(frame.name, str(error))

    def couples() -> Iterator[tuple[int, View, View]]:
        before: tuple[int, View] | None = None
        for number, view in enumerate(read_ahead(read, frames, threads=threads, ahead=threads + 2)):
            if isinstance(view, SkippedFrame):
                chain.skipped.append(view)
                continue
            chain.seen[number] = Seen(view.features, view.depth_m, view.mean_color)
            if before is not None:
                yield before[0], before[1], view
            before = number, view

    def place(couple: tuple[int, View, View]) -> tuple[int, Motion | NoMotion]:
        number, source, target = couple
        # The motion of the later one to the earlier, so that poses are products from left to right.
        return number, motion_between(target, source, max_depth)

    for number, motion in read_ahead(place, couples(), threads=threads, ahead=threads + 2):
        chain.motions[number] = motion
        progress(number + 1, len(frames))
    return chain


def key_frames(chain: Chain) -> tuple[list[int], dict[int, Pose]]:
    """Return the key frames, and poses of all frames along the chain; after a break they start anew."""
    numbers = chain.numbers
    poses = {numbers[0]: np.eye(4)}
    keys = [numbers[0]]
    for before, number in itertools.pairwise(numbers):
        motion = chain.motions[before]
        if isinstance(motion, NoMotion):
            poses[number] = np.eye(4)
            # The last one before a break too: it is the one most like what may come back.
            keys += [before] * (keys[-1] != before) + [number]
            continue
        poses[number] = poses[before] @ motion.target_from_source
        moved = inverted(poses[keys[-1]]) @ poses[number]
        far = np.linalg.norm(moved[:3, 3]) > _KEY_SHIFT * chain.seen[number].depth_m
        if far or angle(moved) > _KEY_TURN or number - keys[-1] >= _KEY_FRAMES:
            keys.append(number)
    return keys + [numbers[-1]] * (keys[-1] != numbers[-1]), poses


def key_edges(
    frames: Sequence[Frame],
    chain: Chain,
    keys: Sequence[int],
    poses: dict[int, Pose],
    max_depth: float,
) -> Iterator[Edge]:
    """Yield the motions between key frames that follow each other, found at once where that works.

    Every alignment comes out a little short, since noise holds a surface where it is: one over many frames is
    less short than many put together.
    """

    def place(edge: Edge) -> Edge:
        source, target = (
            read_view(frames[keys[at]], max_depth, chain.seen[keys[at]].features)
            for at in (edge.source, edge.target)
        )
        motion = motion_between(source, target, max_depth, edge.motion.target_from_source)
        if isinstance(motion, NoMotion) or motion.is_split:
            return edge
        off = inverted(edge.motion.target_from_source) @ motion.target_from_source
        return replace(edge, motion=motion) if agree(off, source.depth_m) else edge

    threads = workers()
    yield from read_ahead(place, _chain_edges(chain, keys, poses), threads=threads, ahead=threads + 2)


def _chain_edges(chain: Chain, keys: Sequence[int], poses: dict[int, Pose]) -> Iterator[Edge]:
    """Yield the motions between key frames that follow each other, put together from those between."""
    numbers = chain.numbers
    for a, b in itertools.pairwise(range(len(keys))):
        between = [chain.motions[n] for n in numbers if keys[a] <= n < keys[b]]
        motions = [motion for motion in between if isinstance(motion, Motion)]
        if len(motions) < len(between):
            continue
        weakest = min(motions, key=lambda motion: motion.fitness)
        yield Edge(
            b,
            a,
            Motion(
                inverted(poses[keys[a]]) @ poses[keys[b]],
                weakest.information / len(motions),
                weakest.fitness,
                max(motion.rmse_m for motion in motions),
                min(motion.points for motion in motions),
                any(motion.is_split for motion in motions),
            ),
            is_certain=True,
        )
