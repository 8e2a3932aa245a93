"""Poses of all frames: initial poses, pose graph of the key frames, interpolation in between."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from heapq import heappop, heappush
from itertools import count

import numpy as np

from scanloom.stages.registration.chain import Chain
from scanloom.stages.registration.graph import Edge, optimised
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Pose

# Correspondence distance of the pose graph, relative to the median depth.
_REACH_SHARE = 0.03


def placed_pieces(
    chain: Chain, groups: Sequence[Sequence[int]], edges: Sequence[Edge], held: Sequence[Edge] = ()
) -> tuple[dict[int, Pose], list[Edge], list[Edge]]:
    """Compute the poses of all frames, component by component.

    Parameters
    ----------
    chain : odometry with key frames.
    groups : indices of the key frames in each connected component.
    edges : motions between key frames.
    held : additional edges that tie key frames to known poses; not part of the results.

    Returns
    -------
    Poses (world_from_camera) by frame index, accepted edges, and rejected edges. The world of each component
    is the camera of its first key frame.
    """
    poses: dict[int, Pose] = {}
    used: list[Edge] = []
    wrong: list[Edge] = []
    group_of = {key: i for i, group in enumerate(groups) for key in group}
    edges_of: list[list[Edge]] = [[] for _ in groups]
    for edge in edges:
        edges_of[group_of[edge.source]].append(edge)
    for group, own in zip(groups, edges_of, strict=True):
        starts = _spread(group, own)
        reach = _REACH_SHARE * float(np.median([chain.seen[chain.keys[key]].depth_m for key in group]))
        beside = [edge for edge in held if edge.source in starts]
        placed, is_used = optimised(starts, [*own, *beside], reach)
        is_used = is_used[: len(own)]
        used += [edge for edge, kept in zip(own, is_used, strict=True) if kept]
        wrong += [edge for edge, kept in zip(own, is_used, strict=True) if not kept]
        poses |= {chain.keys[key]: pose for key, pose in placed.items()}
    return poses | _between(chain, poses), used, wrong


def _spread(group: Sequence[int], edges: Sequence[Edge]) -> dict[int, Pose]:
    """Chain initial poses of a component, along certain edges first."""
    motions: dict[int, list[tuple[int, Pose, bool]]] = {key: [] for key in group}
    for edge in edges:
        motion = edge.motion.target_from_source
        motions[edge.target].append((edge.source, motion, edge.is_certain))
        motions[edge.source].append((edge.target, inverted(motion), edge.is_certain))
    poses: dict[int, Pose] = {}
    # The counter decides between equal entries, because poses cannot be compared.
    order = count()
    reached = [(False, group[0], group[0], next(order), np.eye(4))]
    while reached:
        _, _, key, _, pose = heappop(reached)
        if key in poses:
            continue
        poses[key] = pose
        for other, motion, certain in motions[key]:
            if other not in poses:
                heappush(reached, (not certain, key, other, next(order), pose @ motion))
    return poses


def _between(chain: Chain, placed: dict[int, Pose]) -> dict[int, Pose]:
    """Interpolate the poses of frames between key frames.

    Chained poses are corrected evenly, so that they meet the key frames at both ends.
    """
    from scipy.spatial.transform import Rotation, Slerp

    poses = {}
    starts = chain.poses
    for number in chain.seen:
        if number in placed:
            continue
        at = bisect_left(chain.keys, number)
        before, after = chain.keys[at - 1], chain.keys[at]
        # The frames at both ends of a break are key frames, so that the chain between these two is unbroken.
        first = placed[before] @ inverted(starts[before]) @ starts[number]
        second = placed[after] @ inverted(starts[after]) @ starts[number]
        share = (number - before) / (after - before)
        turns = Slerp([0, 1], Rotation.from_matrix(np.stack([first[:3, :3], second[:3, :3]])))
        pose = np.eye(4)
        pose[:3, :3] = turns(share).as_matrix()
        pose[:3, 3] = (1 - share) * first[:3, 3] + share * second[:3, 3]
        poses[number] = pose
    return poses
