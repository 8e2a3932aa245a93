"""Loop closures are kept if true.

A camera rotates between walls with equal posters and returns to its start.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from poster_room import STEP, make_turning_frames

from scanloom.stages.progress import ignore_progress
from scanloom.stages.registration.loop_closure import _join_parts, _select_pairs_between_parts
from scanloom.stages.registration.motion import Motion, compute_rotation_angle, estimate_motion
from scanloom.stages.registration.odometry_chain import align_key_frames, build_odometry_chain
from scanloom.stages.registration.pose_graph import PoseGraphEdge, find_components
from scanloom.stages.registration.pose_selection import select_poses
from scanloom.stages.registration.register import _drop_unconfirmed, register
from scanloom.stages.registration.surface_alignment import limit_threads
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Frame, Pose

pytestmark = pytest.mark.slow

MAX_DEPTH_M = 5.0


def hide_poses(frames: Sequence[Frame]) -> list[Frame]:
    return [replace(frame, world_from_camera=None) for frame in frames]


def get_pose(frame: Frame) -> Pose:
    pose = frame.world_from_camera
    assert pose is not None
    return np.asarray(pose)


def compute_angle_between(truth: Sequence[Frame], a: int, b: int) -> float:
    """Compute the angle between two cameras in degrees."""
    return float(np.degrees(compute_rotation_angle(invert_pose(get_pose(truth[a])) @ get_pose(truth[b]))))


def compute_rotation_errors(truth: Sequence[Frame], poses: Sequence[Pose]) -> list[float]:
    """Compute rotation errors relative to the first frame in degrees."""
    return [
        float(
            np.degrees(
                compute_rotation_angle(
                    invert_pose(invert_pose(get_pose(truth[0])) @ get_pose(true))
                    @ invert_pose(poses[0])
                    @ pose
                )
            )
        )
        for true, pose in zip(truth, poses, strict=True)
    ]


def test_a_false_loop_is_dropped_and_a_true_loop_is_kept() -> None:
    truth = make_turning_frames(0, 390)
    with_loops, without = register(hide_poses(truth)), register(hide_poses(truth), loops=False)
    assert len(with_loops.frames) == len(without.frames) == len(truth)

    def apart(edge: Mapping[str, Any]) -> float:
        return STEP * (edge["source"] - edge["target"])

    back = [edge for edge in with_loops.edges if edge["is_loop"] and apart(edge) > 120]
    false = [edge for edge in back if compute_angle_between(truth, edge["source"], edge["target"]) > 90]
    true = [edge for edge in back if edge not in false]
    # Features on the posters match, and all points of their walls overlap.
    assert len(false) >= 3
    assert max(edge["fitness"] for edge in false) > 0.95
    assert not any(edge["is_used"] for edge in false)
    assert len(true) >= 10
    assert all(edge["is_used"] for edge in true)
    off = [
        compute_rotation_errors(truth, [get_pose(frame) for frame in one.frames])
        for one in (with_loops, without)
    ]
    assert max(off[0]) < 0.1
    assert np.mean(off[0]) < 0.7 * np.mean(off[1])


def test_uncontradicted_false_loops_do_not_distort_the_trajectory() -> None:
    truth = make_turning_frames(-30, 210)
    with limit_threads():
        chain = build_odometry_chain(hide_poses(truth), MAX_DEPTH_M, ignore_progress, {})
        certain = list(align_key_frames(chain, MAX_DEPTH_M))
        false = []
        for later, earlier in itertools.combinations(range(len(chain.key_indices) - 1, -1, -1), 2):
            here, there = (chain.views.get_view(chain.key_indices[at]) for at in (later, earlier))
            if compute_angle_between(truth, chain.key_indices[later], chain.key_indices[earlier]) > 150:
                motion = estimate_motion(here, there, MAX_DEPTH_M)
                if isinstance(motion, Motion) and motion.inlier_count >= 25:
                    false.append(PoseGraphEdge(later, earlier, motion, is_certain=False))
        assert len(false) >= 6
        groups = find_components(len(chain.key_indices), certain)
        found = select_poses(chain, groups, [*certain, *false], {})
        alone = select_poses(chain, groups, certain, {})
    assert {id(edge) for edge in found.rejected} == {id(edge) for edge in false}
    shifts = [np.linalg.norm(found.poses[at][:3, 3] - alone.poses[at][:3, 3]) for at in range(len(truth))]
    assert max(shifts) < 1e-4
    assert max(compute_rotation_errors(truth, [found.poses[place] for place in range(len(truth))])) < 0.3


def make_edge(
    source: int, target: int, fitness: float, points: int, *, is_certain: bool = False
) -> PoseGraphEdge:
    return PoseGraphEdge(source, target, Motion(np.eye(4), np.eye(6), fitness, None, points), is_certain)


def test_a_weak_edge_is_kept_if_another_edge_confirms_it() -> None:
    strong, weak, across = make_edge(1, 0, 0.8, 60), make_edge(2, 1, 0.3, 40), make_edge(2, 0, 0.5, 30)
    assert _drop_unconfirmed([0, 5, 9], [strong, weak]) == [strong]
    assert _drop_unconfirmed([0, 5, 9], [strong, weak, across]) == [strong, weak, across]
    few = make_edge(2, 1, 0.5, 8, is_certain=True)
    assert _drop_unconfirmed([0, 5, 6], [strong, few]) == [strong]
    # Dropping the link would disconnect the frames in between.
    assert _drop_unconfirmed([0, 5, 9], [strong, few]) == [strong, few]


def test_pairs_between_components_are_all_pairs_of_different_components() -> None:
    alike = np.zeros((4, 4), np.float32)
    assert _select_pairs_between_parts(alike, np.array([0, 0, 1, 2])) == {
        (2, 0),
        (2, 1),
        (3, 0),
        (3, 1),
        (3, 2),
    }
    assert _select_pairs_between_parts(alike, np.zeros(4, int)) == set()
    parts = _join_parts(np.array([0, 0, 1, 2]), [make_edge(3, 2, 0.5, 30), make_edge(2, 0, 0.5, 30)])
    assert _select_pairs_between_parts(alike, parts) == set()
