"""Loop closures: motions between key frames that are not consecutive but show the same place."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.progress import Progress
from scanloom.stages.registration.appearance import compute_similarity
from scanloom.stages.registration.features import estimate_motions
from scanloom.stages.registration.motion import (
    AlignmentFailure,
    Motion,
    align_by_points,
    align_surfaces,
    is_within_drift,
)
from scanloom.stages.registration.odometry_chain import OdometryChain
from scanloom.stages.registration.pose_graph import PoseGraphEdge
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Pose

# Maximum number of candidates per key frame: nearest by pose, and most similar by appearance.
_MAX_NEAR_PAIRS, _MAX_SIMILAR_PAIRS = 5, 3
# Minimum number of inlier matches of a loop.
_MIN_LOOP_POINTS = 25
# If both views have this many features but no match, surfaces alone are not accepted. Then the minimum
# similarity of views, above the similarity that occurs by chance.
_RICH_FEATURE_COUNT = 100
_MIN_SIMILARITY = 0.15
# Maximum number of frame pairs of different parts, the most similar first. Pairs take little time, because
# those without common features are rejected before surfaces are aligned.
_MAX_PAIRS_BETWEEN_PARTS = 500


def find_loop_closures(
    chain: OdometryChain, max_depth: float, given_poses: Mapping[int, Pose], progress: Progress
) -> list[PoseGraphEdge]:
    """Find loop closures between key frames.

    Parameters
    ----------
    chain : odometry with key frames.
    max_depth : farther depth is ignored, metres.
    given_poses : world_from_camera by frame index; if complete, these poses select nearby candidates.
    progress : called for the second half of the work; the frames are the first half.
    """
    features = [chain.views.features[key] for key in chain.key_indices]
    depths = np.array([chain.summaries[key].depth_m for key in chain.key_indices])
    known = given_poses if all(key in given_poses for key in chain.key_indices) else chain.poses
    poses = np.array([known[key] for key in chain.key_indices])
    breaks = chain.break_indices
    parts = np.array([bisect_left(breaks, key) for key in chain.key_indices])

    def align_pair(couple: tuple[int, int]) -> PoseGraphEdge | None:
        source, target = couple
        points = estimate_motions(features[source], features[target])
        points = [one for one in points if one.inlier_count >= _MIN_LOOP_POINTS]
        rich = min(len(features[source].points), len(features[target].points)) >= _RICH_FEATURE_COUNT
        if not points and (rich or parts[source] != parts[target]):
            return None
        here, there = (chain.views.get_view(chain.key_indices[at]) for at in couple)
        if points:
            motion = align_by_points(here, there, points, max_depth)
        else:
            guess = invert_pose(poses[target]) @ poses[source]
            motion = align_surfaces(here, there, max_depth, guess, is_good_guess=True)
            if isinstance(motion, Motion) and not is_within_drift(
                invert_pose(guess) @ motion.target_from_source, depths[source]
            ):
                return None
        return (
            None
            if isinstance(motion, AlignmentFailure)
            else PoseGraphEdge(source, target, motion, is_certain=False)
        )

    alike = compute_similarity(features)
    couples = sorted(_select_near_pairs(poses, depths, parts) | _select_similar_pairs(alike, parts))
    threads = get_worker_count()
    found = map_ordered(align_pair, couples, threads=threads, max_pending=2 * threads)
    frames, edges = len(chain.summaries) + len(chain.skipped), []
    for done, edge in enumerate(found, 1):
        progress(frames + frames * done // len(couples), 2 * frames)
        if edge is not None:
            edges.append(edge)
    # Similarity is unreliable for views without order, so more pairs are tried between parts still
    # disconnected.
    apart = sorted(_select_pairs_between_parts(alike, _join_parts(parts, edges)) - set(couples))
    more = map_ordered(align_pair, apart, threads=threads, max_pending=2 * threads)
    return [*edges, *(edge for edge in more if edge is not None)]


def _select_near_pairs(
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
        nearest = earlier[meet][np.argsort(apart[meet], kind="stable")[:_MAX_NEAR_PAIRS]]
        couples |= {(later, int(one)) for one in nearest}
    return couples


def _select_similar_pairs(similarity: NDArray[np.float32], parts: NDArray[np.int64]) -> set[tuple[int, int]]:
    """Select the most similar key-frame pairs (later, earlier).

    Consecutive key frames count only across a break.
    """
    places = np.arange(len(parts))
    couples = set()
    for one in places:
        apart = np.abs(places - one)
        may = (similarity[one] >= _MIN_SIMILARITY) & ((apart > 1) | ((apart == 1) & (parts != parts[one])))
        others = places[may][np.argsort(-similarity[one, may], kind="stable")[:_MAX_SIMILAR_PAIRS]]
        couples |= {(int(max(one, o)), int(min(one, o))) for o in others}
    return couples


def _select_pairs_between_parts(
    similarity: NDArray[np.float32], parts: NDArray[np.int64]
) -> set[tuple[int, int]]:
    """Select the most similar key-frame pairs (later, earlier) of different parts.

    Parameters
    ----------
    similarity : (n, n) similarity of views. It is unreliable for small overlaps, so few pairs are all
        selected.
    parts : (n,) index of the part of a broken chain for each key frame.
    """
    later, earlier = np.nonzero(np.tril(parts[:, None] != parts))
    order = np.argsort(-similarity[later, earlier], kind="stable")[:_MAX_PAIRS_BETWEEN_PARTS]
    return {(int(a), int(b)) for a, b in zip(later[order], earlier[order], strict=True)}


def _join_parts(parts: NDArray[np.int64], edges: Sequence[PoseGraphEdge]) -> NDArray[np.int64]:
    """Merge the parts (n,) that edges have connected."""
    found: NDArray[np.int64] = parts.copy()
    for edge in edges:
        found[found == found[edge.source]] = found[edge.target]
    return found
