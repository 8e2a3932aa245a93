"""Poses of all frames: first along the motions, then those that agree best, then between key frames."""

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

# Surfaces count as the same within this share of the median depth.
_REACH_SHARE = 0.03


def placed_pieces(
    chain: Chain, groups: Sequence[Sequence[int]], edges: Sequence[Edge], held: Sequence[Edge] = ()
) -> tuple[dict[int, Pose], list[Edge], list[Edge]]:
    """Return the poses of all frames, each piece in the world of its first, and edges used and refused.

    Parameters
    ----------
    groups : numbers of the key frames of each piece.
    held : edges beside these, of poses that are known from elsewhere.
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
    """Return first poses for a piece: along its certain edges where there are such, else along any."""
    motions: dict[int, list[tuple[int, Pose, bool]]] = {key: [] for key in group}
    for edge in edges:
        motion = edge.motion.target_from_source
        motions[edge.target].append((edge.source, motion, edge.is_certain))
        motions[edge.source].append((edge.target, inverted(motion), edge.is_certain))
    poses: dict[int, Pose] = {}
    # Poses cannot be compared: a number that differs ends the comparison before them.
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
    """Return the poses of frames between key frames: what the chain says, bent evenly to meet both."""
    from scipy.spatial.transform import Rotation, Slerp

    poses = {}
    starts = chain.poses
    for number in chain.seen:
        if number in placed:
            continue
        at = bisect_left(chain.keys, number)
        before, after = chain.keys[at - 1], chain.keys[at]
        # Key frames stand at both sides of a break, so that there is none between these two.
        first = placed[before] @ inverted(starts[before]) @ starts[number]
        second = placed[after] @ inverted(starts[after]) @ starts[number]
        share = (number - before) / (after - before)
        turns = Slerp([0, 1], Rotation.from_matrix(np.stack([first[:3, :3], second[:3, :3]])))
        pose = np.eye(4)
        pose[:3, :3] = turns(share).as_matrix()
        pose[:3, 3] = (1 - share) * first[:3, 3] + share * second[:3, 3]
        poses[number] = pose
    return poses
