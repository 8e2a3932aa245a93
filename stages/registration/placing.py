"""Poses of all frames: first along the motions, then those that agree best, then between key frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.formats.trajectories import inverted
from stages.registration.chain import Chain
from stages.registration.graph import Edge, optimised
from stages.scan import Pose

# Surfaces count as the same within this share of the median depth.
_REACH_SHARE = 0.03


def placed_pieces(
    chain: Chain,
    keys: Sequence[int],
    starts: dict[int, Pose],
    groups: Sequence[Sequence[int]],
    edges: Sequence[Edge],
) -> tuple[dict[int, Pose], list[Edge], list[Edge]]:
    """Return the poses of all frames, each piece in the world of its first, and edges used and refused."""
    poses: dict[int, Pose] = {}
    used: list[Edge] = []
    wrong: list[Edge] = []
    for group in groups:
        members = set(group)
        own = [edge for edge in edges if edge.source in members]
        reach = _REACH_SHARE * float(np.median([chain.seen[keys[key]].depth_m for key in group]))
        placed, refused = optimised(_spread(group, own), own, reach)
        used += [edge for edge in own if edge not in refused]
        wrong += refused
        poses |= {keys[key]: pose for key, pose in placed.items()}
    return poses | _between(chain, keys, starts, poses), used, wrong


def _spread(group: Sequence[int], edges: Sequence[Edge]) -> dict[int, Pose]:
    """Return first poses for a piece: along its certain edges where there are such, else along any."""
    motions: dict[int, list[tuple[int, Pose, bool]]] = {key: [] for key in group}
    for edge in edges:
        motion = edge.motion.target_from_source
        motions[edge.target].append((edge.source, motion, edge.is_certain))
        motions[edge.source].append((edge.target, inverted(motion), edge.is_certain))
    poses = {group[0]: np.eye(4)}
    while len(poses) < len(group):
        reached = [
            (not certain, key, other, motion)
            for key in poses
            for other, motion, certain in motions[key]
            if other not in poses
        ]
        _, key, other, motion = min(reached, key=lambda one: one[:3])
        poses[other] = poses[key] @ motion
    return poses


def _between(
    chain: Chain, keys: Sequence[int], starts: dict[int, Pose], placed: dict[int, Pose]
) -> dict[int, Pose]:
    """Return the poses of frames between key frames: what the chain says, bent evenly to meet both."""
    from scipy.spatial.transform import Rotation, Slerp

    poses = {}
    numbers = [number for number in chain.numbers if number not in placed]
    for number in numbers:
        before = max(key for key in keys if key < number)
        after = min(key for key in keys if key > number)
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
