"""Loops: key frames that show the same place though they do not follow each other."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stages.formats.trajectories import inverted
from stages.prefetch import read_ahead, workers
from stages.registration.appearance import likeness
from stages.registration.chain import Chain, Seen
from stages.registration.features import recognise
from stages.registration.graph import Edge
from stages.registration.motion import Motion, NoMotion, angle, by_points, by_surface
from stages.registration.view import View, read_view
from stages.scan import Frame, Pose

# Loops are looked for with this many views that should overlap and this many that look alike.
_NEAR, _ALIKE = 10, 4
# What is recognised in both for a loop to be believed, and how likely two views look alike by chance.
_LOOP_POINTS = 25
_LEAST_LIKENESS = 0.15
# How far the chain may have drifted where surfaces alone close a loop: in median depths, and radians.
_DRIFT_SHIFT, _DRIFT_TURN = 0.1, 0.1
# Views whose images are kept at a time.
_HELD = 48


def loops(
    frames: Sequence[Frame],
    chain: Chain,
    keys: Sequence[int],
    poses: dict[int, Pose],
    max_depth: float,
) -> list[Edge]:
    """Return motions between key frames that do not follow each other and show the same place."""
    seen = [chain.seen[key] for key in keys]
    parts = _parts(chain, keys)

    @lru_cache(maxsize=_HELD)
    def view(key: int) -> View:
        return read_view(frames[keys[key]], max_depth, seen[key].features)

    def close(couple: tuple[int, int]) -> Edge | None:
        source, target = couple
        points = recognise(seen[source].features, seen[target].features)
        points = [one for one in points if one.points >= _LOOP_POINTS]
        if points:
            motion = by_points(view(source), view(target), points, max_depth)
        elif parts[source] == parts[target]:
            guess = inverted(poses[keys[target]]) @ poses[keys[source]]
            motion = by_surface(view(source), view(target), max_depth, guess)
            if isinstance(motion, Motion) and not _is_near(guess, motion, seen[source].depth_m):
                return None
        else:
            return None
        return None if isinstance(motion, NoMotion) else Edge(source, target, motion, is_certain=False)

    alike = likeness([one.features for one in seen])
    couples = sorted(_near(keys, parts, poses, seen) | _alike(alike, parts))
    threads = workers()
    found = read_ahead(close, couples, threads=threads, ahead=2 * threads)
    return [edge for edge in found if edge is not None]


def _is_near(guess: Pose, motion: Motion, depth: float) -> bool:
    off = inverted(guess) @ motion.target_from_source
    return bool(np.linalg.norm(off[:3, 3]) < _DRIFT_SHIFT * depth and angle(off) < _DRIFT_TURN)


def _parts(chain: Chain, keys: Sequence[int]) -> list[int]:
    """Return for each key frame how many breaks are before it."""
    broken = [number for number, motion in chain.motions.items() if isinstance(motion, NoMotion)]
    return [sum(number < key for number in broken) for key in keys]


def _near(
    keys: Sequence[int], parts: Sequence[int], poses: dict[int, Pose], seen: Sequence[Seen]
) -> set[tuple[int, int]]:
    """Return couples (later, earlier) of key frames whose poses let them look at the same place."""
    placed = [poses[key] for key in keys]
    centres = np.array([pose[:3, 3] for pose in placed])
    axes = np.array([pose[:3, 2] for pose in placed])
    depths = np.array([one.depth_m for one in seen])
    focus = centres + axes * depths[:, None]
    couples = set()
    for later in range(len(keys)):
        order = []
        for earlier in range(later - 1):
            if parts[earlier] != parts[later] or axes[later] @ axes[earlier] < 0.5:
                continue
            apart = np.linalg.norm(focus[later] - focus[earlier]) / depths[later]
            if apart < 0.7:
                order.append((float(apart), earlier))
        couples |= {(later, earlier) for _, earlier in sorted(order)[:_NEAR]}
    return couples


def _alike(alike: NDArray[np.float32], parts: Sequence[int]) -> set[tuple[int, int]]:
    """Return couples (later, earlier) of key frames that look most alike, neighbours only across a break."""
    couples = set()
    for one in range(len(alike)):
        others = [o for o in range(len(alike)) if abs(o - one) > 1 or (o != one and parts[o] != parts[one])]
        others = sorted(others, key=lambda o: (-alike[one, o], o))[:_ALIKE]
        couples |= {(max(one, o), min(one, o)) for o in others if alike[one, o] >= _LEAST_LIKENESS}
    return couples
