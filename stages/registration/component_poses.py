"""Poses of all frames: initial poses, pose graph of the key frames, interpolation in between."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from heapq import heappop, heappush
from itertools import count

import numpy as np

from scanloom.stages.registration.odometry_chain import OdometryChain
from scanloom.stages.registration.pose_graph import PoseGraphEdge, optimise_poses
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Pose

# Correspondence distance of the pose graph, relative to the median depth.
_REACH_RATIO = 0.03


def estimate_component_poses(
    chain: OdometryChain,
    components: Sequence[Sequence[int]],
    edges: Sequence[PoseGraphEdge],
    prior_edges: Sequence[PoseGraphEdge] = (),
) -> tuple[dict[int, Pose], list[PoseGraphEdge], list[PoseGraphEdge]]:
    """Compute the poses of all frames, component by component.

    Parameters
    ----------
    chain : odometry with key frames.
    components : indices of the key frames in each connected component.
    edges : motions between key frames.
    prior_edges : additional edges that tie key frames to known poses; not part of the results.

    Returns
    -------
    Poses (world_from_camera) by frame index, accepted edges, and rejected edges. The world of each component
    is the camera of its first key frame.
    """
    poses: dict[int, Pose] = {}
    used: list[PoseGraphEdge] = []
    wrong: list[PoseGraphEdge] = []
    group_of = {key: i for i, group in enumerate(components) for key in group}
    edges_of: list[list[PoseGraphEdge]] = [[] for _ in components]
    for edge in edges:
        edges_of[group_of[edge.source]].append(edge)
    for group, own in zip(components, edges_of, strict=True):
        starts = _chain_initial_poses(group, own)
        reach = _REACH_RATIO * float(
            np.median([chain.summaries[chain.key_indices[key]].depth_m for key in group])
        )
        beside = [edge for edge in prior_edges if edge.source in starts]
        placed, is_used = optimise_poses(starts, [*own, *beside], reach)
        is_used = is_used[: len(own)]
        used += [edge for edge, kept in zip(own, is_used, strict=True) if kept]
        wrong += [edge for edge, kept in zip(own, is_used, strict=True) if not kept]
        poses |= {chain.key_indices[key]: pose for key, pose in placed.items()}
    return poses | _interpolate_poses(chain, poses), used, wrong


def _chain_initial_poses(component: Sequence[int], edges: Sequence[PoseGraphEdge]) -> dict[int, Pose]:
    """Chain initial poses of a component, along certain edges first."""
    motions: dict[int, list[tuple[int, Pose, bool]]] = {key: [] for key in component}
    for edge in edges:
        motion = edge.motion.target_from_source
        motions[edge.target].append((edge.source, motion, edge.is_certain))
        motions[edge.source].append((edge.target, invert_pose(motion), edge.is_certain))
    poses: dict[int, Pose] = {}
    # The counter decides between equal entries, because poses cannot be compared.
    order = count()
    reached = [(False, component[0], component[0], next(order), np.eye(4))]
    while reached:
        _, _, key, _, pose = heappop(reached)
        if key in poses:
            continue
        poses[key] = pose
        for other, motion, certain in motions[key]:
            if other not in poses:
                heappush(reached, (not certain, key, other, next(order), pose @ motion))
    return poses


def _interpolate_poses(chain: OdometryChain, key_poses: dict[int, Pose]) -> dict[int, Pose]:
    """Interpolate the poses of frames between key frames.

    Chained poses are corrected evenly, so that they meet the key frames at both ends.
    """
    from scipy.spatial.transform import Rotation, Slerp

    poses = {}
    starts = chain.poses
    for number in chain.summaries:
        if number in key_poses:
            continue
        at = bisect_left(chain.key_indices, number)
        before, after = chain.key_indices[at - 1], chain.key_indices[at]
        # The frames at both ends of a break are key frames, so that the chain between these two is unbroken.
        first = key_poses[before] @ invert_pose(starts[before]) @ starts[number]
        second = key_poses[after] @ invert_pose(starts[after]) @ starts[number]
        share = (number - before) / (after - before)
        turns = Slerp([0, 1], Rotation.from_matrix(np.stack([first[:3, :3], second[:3, :3]])))
        pose = np.eye(4)
        pose[:3, :3] = turns(share).as_matrix()
        pose[:3, 3] = (1 - share) * first[:3, 3] + share * second[:3, 3]
        poses[number] = pose
    return poses
