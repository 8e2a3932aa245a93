"""Loop closures: motions between key frames that are not consecutive but show the same place."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.progress import Progress
from scanloom.stages.registration.appearance import likeness
from scanloom.stages.registration.chain import Chain
from scanloom.stages.registration.features import recognise
from scanloom.stages.registration.graph import Edge
from scanloom.stages.registration.motion import Motion, NoMotion, by_points, by_surface, is_near
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Pose

# Maximum number of candidates per key frame: nearest by pose, and most similar by appearance.
_NEAR, _ALIKE = 5, 3
# Minimum number of inlier matches of a loop.
_LOOP_POINTS = 25
# If both views have this many features but no match, surfaces alone are not accepted. Then the minimum
# similarity of views, above the similarity that occurs by chance.
_RICH = 100
_LEAST_LIKENESS = 0.15
# Maximum number of frame pairs of different parts, the most similar first. Pairs take little time, because
# those without common features are rejected before surfaces are aligned.
_MAX_PAIRS_BETWEEN_PARTS = 500


def loops(chain: Chain, max_depth: float, given: Mapping[int, Pose], progress: Progress) -> list[Edge]:
    """Find loop closures between key frames.

    Parameters
    ----------
    chain : odometry with key frames.
    max_depth : farther depth is ignored, metres.
    given : world_from_camera by frame index; if complete, these poses select nearby candidates.
    progress : called for the second half of the work; the frames are the first half.
    """
    features = [chain.views.features[key] for key in chain.keys]
    depths = np.array([chain.seen[key].depth_m for key in chain.keys])
    known = given if all(key in given for key in chain.keys) else chain.poses
    poses = np.array([known[key] for key in chain.keys])
    breaks = chain.breaks
    parts = np.array([bisect_left(breaks, key) for key in chain.keys])

    def close(couple: tuple[int, int]) -> Edge | None:
        source, target = couple
        points = recognise(features[source], features[target])
        points = [one for one in points if one.points >= _LOOP_POINTS]
        rich = min(len(features[source].points), len(features[target].points)) >= _RICH
        if not points and (rich or parts[source] != parts[target]):
            return None
        here, there = (chain.views.view(chain.keys[at]) for at in couple)
        if points:
            motion = by_points(here, there, points, max_depth)
        else:
            guess = inverted(poses[target]) @ poses[source]
            motion = by_surface(here, there, max_depth, guess, near=True)
            if isinstance(motion, Motion) and not is_near(
                inverted(guess) @ motion.target_from_source, depths[source]
            ):
                return None
        return None if isinstance(motion, NoMotion) else Edge(source, target, motion, is_certain=False)

    alike = likeness(features)
    couples = sorted(_near(poses, depths, parts) | _alike(alike, parts))
    threads = workers()
    found = read_ahead(close, couples, threads=threads, ahead=2 * threads)
    frames, edges = len(chain.seen) + len(chain.skipped), []
    for done, edge in enumerate(found, 1):
        progress(frames + frames * done // len(couples), 2 * frames)
        if edge is not None:
            edges.append(edge)
    # Similarity is unreliable for views without order, so more pairs are tried between parts still
    # disconnected.
    apart = sorted(_pairs_between_parts(alike, _join_parts(parts, edges)) - set(couples))
    more = read_ahead(close, apart, threads=threads, ahead=2 * threads)
    return [*edges, *(edge for edge in more if edge is not None)]


def _near(
    poses: NDArray[np.float64], depths: NDArray[np.float64], parts: NDArray[np.int64]
) -> set[tuple[int, int]]:
    """Select key-frame pairs (later, earlier) that may see the same place by pose."""
    axes = poses[:, :3, 2]
    focus = poses[:, :3, 3] + axes * depths[:, None]
    couples = set()
    for later in range(2, len(poses)):
        earlier = np.arange(later - 1)
        apart = np.linalg.norm(focus[later] - focus[earlier], axis=1) / depths[later]
        meet = (parts[earlier] == parts[later]) & (axes[earlier] @ axes[later] >= 0.5) & (apart < 0.7)
        nearest = earlier[meet][np.argsort(apart[meet], kind="stable")[:_NEAR]]
        couples |= {(later, int(one)) for one in nearest}
    return couples


def _alike(alike: NDArray[np.float32], parts: NDArray[np.int64]) -> set[tuple[int, int]]:
    """Select the most similar key-frame pairs (later, earlier).

    Consecutive key frames count only across a break.
    """
    places = np.arange(len(parts))
    couples = set()
    for one in places:
        apart = np.abs(places - one)
        may = (alike[one] >= _LEAST_LIKENESS) & ((apart > 1) | ((apart == 1) & (parts != parts[one])))
        others = places[may][np.argsort(-alike[one, may], kind="stable")[:_ALIKE]]
        couples |= {(int(max(one, o)), int(min(one, o))) for o in others}
    return couples


def _pairs_between_parts(alike: NDArray[np.float32], parts: NDArray[np.int64]) -> set[tuple[int, int]]:
    """Select the most similar key-frame pairs (later, earlier) of different parts.

    Parameters
    ----------
    alike : (n, n) similarity of views. It is unreliable for small overlaps, so few pairs are all selected.
    parts : (n,) index of the part of a broken chain for each key frame.
    """
    later, earlier = np.nonzero(np.tril(parts[:, None] != parts))
    order = np.argsort(-alike[later, earlier], kind="stable")[:_MAX_PAIRS_BETWEEN_PARTS]
    return {(int(a), int(b)) for a, b in zip(later[order], earlier[order], strict=True)}


def _join_parts(parts: NDArray[np.int64], edges: Sequence[Edge]) -> NDArray[np.int64]:
    """Merge the parts (n,) that edges have connected."""
    found: NDArray[np.int64] = parts.copy()
    for edge in edges:
        found[found == found[edge.source]] = found[edge.target]
    return found
