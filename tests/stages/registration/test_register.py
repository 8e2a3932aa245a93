"""Poses estimated from frames, compared with true poses, and errors if poses cannot be estimated."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.registration.features import estimate_motions
from scanloom.stages.registration.motion import (
    AlignmentFailure,
    Motion,
    compute_rotation_angle,
    estimate_motion,
)
from scanloom.stages.registration.pose_graph import PoseGraphEdge, find_components
from scanloom.stages.registration.register import register
from scanloom.stages.registration.registration_result import Registration
from scanloom.stages.registration.view import read_registration_view
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, scale_camera
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.trajectory.trajectory_formats import read_tum, write_tum
from scanloom.stages.stereo.depth import DepthMap, depth_scan

pytestmark = pytest.mark.slow

SAMPLE = Path(__file__).parents[3] / "samples" / "rgbd"
CAMERA = Camera(160, 120, 140, 140, 79.5, 59.5)


def read_sample(every: int = 1) -> list[Frame]:
    return list(read_scan(SAMPLE).frames[::every])


def hide_poses(frames: Sequence[Frame]) -> list[Frame]:
    return [replace(frame, world_from_camera=None) for frame in frames]


def compute_trajectory_error(found: Registration, truth: Sequence[Frame]) -> float:
    """Compute the RMS distance of camera centres after the best rigid motion (Umeyama 1991)."""
    a = np.array([frame.world_from_camera[:3, 3] for frame in found.frames])
    b = np.array([truth[place].world_from_camera[:3, 3] for place in found.frame_indices])
    centred = a - a.mean(axis=0), b - b.mean(axis=0)
    u, _, vt = np.linalg.svd(centred[0].T @ centred[1])
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return float(np.sqrt(((centred[0] @ turn - centred[1]) ** 2).sum(axis=1).mean()))


def compute_path_length(frames: Sequence[Frame]) -> float:
    centres = np.array([frame.world_from_camera[:3, 3] for frame in frames])
    return float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum())


@pytest.fixture(scope="module")
def whole() -> Registration:
    return register(hide_poses(read_sample()))


@pytest.fixture(scope="module")
def half() -> Registration:
    return register(hide_poses(read_sample(2)))


# -- poses -----------------------------------------------------------------------------------------------


def test_poses_of_the_sample_are_within_half_a_percent_of_the_path(whole: Registration) -> None:
    truth = read_sample()
    assert whole.frame_indices == tuple(range(len(truth)))
    assert compute_trajectory_error(whole, truth) < 0.005 * compute_path_length(truth)
    assert len(whole.pieces) == 1
    assert whole.breaks == ()


def test_orientations_agree_with_the_truth(whole: Registration) -> None:
    truth = read_sample()
    first = truth[0].world_from_camera
    for frame, true in zip(whole.frames, truth, strict=True):
        off = invert_pose(invert_pose(first) @ true.world_from_camera) @ frame.world_from_camera
        assert np.trace(off[:3, :3]) > 1 + 2 * np.cos(np.radians(1.0))


def test_the_first_camera_is_the_world(whole: Registration) -> None:
    np.testing.assert_allclose(whole.frames[0].world_from_camera, np.eye(4), atol=1e-12)


def test_existing_poses_are_not_used(half: Registration) -> None:
    wrong = [replace(frame, world_from_camera=np.eye(4)) for frame in read_sample(2)]
    again = register(wrong)
    for one, other in zip(again.frames, half.frames, strict=True):
        np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)


def test_results_do_not_depend_on_the_number_of_threads(
    half: Registration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    again = register(hide_poses(read_sample(2)))
    for one, other in zip(again.frames, half.frames, strict=True):
        np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
    assert again.edges == half.edges


def test_loop_closures_improve_the_poses(whole: Registration) -> None:
    truth = read_sample()
    with_loops, without = whole, register(hide_poses(truth), loops=False)
    assert sum(edge["is_loop"] for edge in with_loops.edges) > 0
    assert not any(edge["is_loop"] for edge in without.edges)
    assert compute_trajectory_error(with_loops, truth) < compute_trajectory_error(without, truth)


def test_frames_without_colour_are_registered_by_geometry() -> None:
    truth = read_sample(2)
    found = register([replace(frame, color=None) for frame in hide_poses(truth)])
    assert len(found.frames) == len(truth)
    assert compute_trajectory_error(found, truth) < 0.02 * compute_path_length(truth)
    assert all(edge["points"] == 0 for edge in found.edges)


def test_geometry_registers_frames_18_degrees_apart() -> None:
    truth = read_sample(3)
    found = register([replace(frame, color=None) for frame in hide_poses(truth)])
    assert len(found.frames) == len(truth)
    assert compute_trajectory_error(found, truth) < 0.005 * compute_path_length(truth)


def test_shuffled_frames_are_registered() -> None:
    truth = read_sample(2)
    order = np.random.default_rng(3).permutation(len(truth))
    shuffled = [truth[i] for i in order]
    found = register(hide_poses(shuffled))
    assert len(found.frames) >= 0.8 * len(truth)
    assert compute_trajectory_error(found, shuffled) < 0.01 * compute_path_length(truth)


def test_frames_of_another_scene_are_a_separate_component() -> None:
    here = hide_poses(read_sample(2))
    there = [render_corner(i) for i in range(3)]
    found = register([*here, *there])
    assert [len(piece) for piece in found.pieces] == [len(here), len(there)]
    assert {one.name for one in found.skipped} == {frame.name for frame in there}
    assert found.breaks[0].name == there[0].name
    assert any("2 pieces" in str(one) for one in found.diagnostics)


def test_another_component_can_be_selected() -> None:
    here, there = hide_poses(read_sample(3)), [render_corner(i) for i in range(3)]
    found = register([*here, *there], piece=2)
    assert found.frame_indices == (8, 9, 10)
    np.testing.assert_allclose(found.frames[0].world_from_camera, np.eye(4), atol=1e-12)
    assert list(found.other_pieces) == [1]
    assert [frame.name for frame in found.other_pieces[1].values()] == [frame.name for frame in here]
    assert list(found.other_pieces[1]) == list(range(8))
    assert compute_trajectory_error(found, [*here, *there]) < 0.002
    with pytest.raises(
        InputError, match=r"register\.piece=3 does not exist; pieces of two or more frames: 2"
    ):
        register([*here[:3], *there], piece=3)


# -- poses that are known roughly ------------------------------------------------------------------------


def test_existing_poses_are_refined_in_their_world_frame() -> None:
    truth = read_sample()
    found = register(disturb_poses(truth), refine=True)
    assert found.frame_indices == tuple(range(len(truth)))
    off = [
        np.linalg.norm((frame.world_from_camera - true.world_from_camera)[:3, 3])
        for frame, true in zip(found.frames, truth, strict=True)
    ]
    rough = [
        np.linalg.norm((frame.world_from_camera - true.world_from_camera)[:3, 3])
        for frame, true in zip(disturb_poses(truth), truth, strict=True)
    ]
    assert np.mean(rough) > 0.02
    # Without alignment: the world frame is kept, up to the mean error of the given poses.
    assert np.mean(off) < 0.4 * np.mean(rough)
    assert compute_trajectory_error(found, truth) < 0.003


def test_poses_are_kept_if_refinement_finds_no_better_ones() -> None:
    wall = np.full((120, 160), 2.0, np.float32)
    poses = [np.eye(4) for _ in range(3)]
    for i, pose in enumerate(poses):
        pose[0, 3] = 0.05 * i
    walls = [Frame(str(i), CAMERA, depth=wall, world_from_camera=pose) for i, pose in enumerate(poses)]
    found = register(walls, refine=True)
    for frame, pose in zip(found.frames, poses, strict=True):
        np.testing.assert_allclose(frame.world_from_camera, pose, atol=1e-6)


def test_true_poses_are_kept_and_reported() -> None:
    truth = read_sample(2)
    found = register(truth, refine=True)
    for frame, true in zip(found.frames, truth, strict=True):
        np.testing.assert_array_equal(frame.world_from_camera, true.world_from_camera)
    assert any("the given poses are kept" in str(one) for one in found.diagnostics)


def test_missing_poses_are_estimated_among_true_ones() -> None:
    truth = read_sample(2)
    some = [replace(one, world_from_camera=None) if i % 4 == 1 else one for i, one in enumerate(truth)]
    found = register(some, refine=True)
    for frame, true in zip(found.frames, truth, strict=True):
        assert np.linalg.norm((frame.world_from_camera - true.world_from_camera)[:3, 3]) < 0.003


def test_refining_needs_poses() -> None:
    with pytest.raises(InputError, match="no frame has a pose that could be refined"):
        register(hide_poses(read_sample(6)), refine=True)


# -- one motion ------------------------------------------------------------------------------------------


def test_a_motion_maps_source_points_to_the_target() -> None:
    truth = read_sample(3)
    source, target = (read_registration_view(frame, 5.0) for frame in truth[:2])
    motion = estimate_motion(source, target, 5.0)
    assert isinstance(motion, Motion)
    expected = invert_pose(truth[1].world_from_camera) @ truth[0].world_from_camera
    moved = np.linalg.norm(expected[:3, 3])
    assert moved > 0.02
    assert np.linalg.norm((motion.target_from_source - expected)[:3, 3]) < 0.05 * moved
    seen = estimate_motions(source.features, target.features)
    assert len(seen) == 1
    assert np.linalg.norm((seen[0].target_from_source - expected)[:3, 3]) < 0.1 * moved


def test_a_flat_wall_does_not_constrain_the_motion() -> None:
    wall = Frame("wall", CAMERA, depth=np.full((120, 160), 2.0, np.float32))
    view = read_registration_view(wall, 10)
    assert view.firmness < 1e-6
    found = estimate_motion(view, view, 10)
    assert isinstance(found, AlignmentFailure)
    assert "flat" in str(found.diagnostic)


def test_a_corner_constrains_the_motion_in_all_directions() -> None:
    assert read_registration_view(render_corner(0), 10).firmness > 0.01


# -- unusable frames -------------------------------------------------------------------------------------


def test_one_frame_is_too_few() -> None:
    with pytest.raises(InputError, match="1 of 1 frames can be used, but registration needs at least two"):
        register(hide_poses(read_sample()[:1]))


def test_a_wall_alone_is_refused_with_the_reason() -> None:
    wall = Frame("wall", CAMERA, depth=np.full((120, 160), 2.0, np.float32))
    with pytest.raises(InputError, match=r"no two of the 3 frames .*flat.*scan\.poses=FILE"):
        register([wall, wall, wall])


def test_empty_and_damaged_frames_are_skipped(tmp_path: Path) -> None:
    frames = hide_poses(read_sample(2))
    (tmp_path / "cut.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    empty = replace(frames[3], name="empty", depth=np.zeros((240, 320), np.float32))
    cut = replace(frames[3], name="cut", depth=tmp_path / "cut.png")
    found = register([*frames[:4], empty, cut, *frames[4:]])
    assert len(found.frames) == len(frames)
    assert [one.name for one in found.skipped] == ["empty", "cut"]
    assert compute_trajectory_error(found, [*read_sample(2)[:4], None, None, *read_sample(2)[4:]]) < 0.01


def test_black_images_are_reported_and_geometry_is_used() -> None:
    truth = read_sample(2)
    black = [replace(frame, color=np.zeros((240, 320, 3), np.uint8)) for frame in hide_poses(truth)]
    found = register(black)
    assert any("colour images are black" in str(one) for one in found.diagnostics)
    assert len(found.frames) >= 2


def test_dark_images_are_recognised() -> None:
    frames = hide_poses(read_sample(6))
    dark = [replace(frame, color=(read_color(frame) * 0.12).astype(np.uint8)) for frame in frames]
    for frame, other in zip(dark, frames, strict=True):
        seen, bright = (read_registration_view(one, 5.0).features for one in (frame, other))
        assert len(seen.points) > 0.7 * len(bright.points)


def test_colour_finer_than_depth_gives_more_features() -> None:
    frame = hide_poses(read_sample())[0]
    depth = read_depth(frame)[::2, ::2]
    coarse = replace(frame, depth=depth, camera=scale_camera(frame.camera, 160, 120), depth_scale=1.0)
    small = replace(coarse, color=np.ascontiguousarray(read_color(frame)[::2, ::2]))
    fine, few = (read_registration_view(one, 5.0).features for one in (coarse, small))
    assert len(fine.points) > 1.5 * len(few.points)
    # Metric positions agree with the positions from full-resolution depth.
    full = read_registration_view(frame, 5.0).features
    apart = np.linalg.norm(fine.points[:, None] - full.points[None], axis=2).min(axis=1)
    assert np.median(apart) < 0.01


def test_a_moving_object_does_not_affect_the_camera_poses(half: Registration) -> None:
    truth = read_sample(2)
    found = register(add_moving_board(hide_poses(truth)))
    assert compute_trajectory_error(found, truth) < 0.01 * compute_path_length(truth)
    assert any("something moves independently" in str(one) for one in found.diagnostics)
    assert not any("independently" in str(one) for one in half.diagnostics)


def test_a_static_camera_is_reported() -> None:
    frame = hide_poses(read_sample())[0]
    found = register([frame, replace(frame, name="again"), replace(frame, name="and again")])
    assert any("does not move" in str(one) for one in found.diagnostics)
    assert any("copies of the previous frame" in str(one) for one in found.diagnostics)


# -- files and components --------------------------------------------------------------------------------


def test_a_trajectory_is_read_back_as_written(tmp_path: Path) -> None:
    poses = [frame.world_from_camera for frame in read_sample()]
    write_tum(tmp_path / "t.tum", list(range(len(poses))), poses)
    back = read_tum(tmp_path / "t.tum")
    np.testing.assert_allclose(np.array(back.poses), np.array(poses), atol=2e-9)
    assert list(back.timestamps) == [1_000_000_000 * i for i in range(len(poses))]


def test_components_are_connected_by_edges() -> None:
    motion = Motion(np.eye(4), np.eye(6), 1.0, 0.0, 0)
    edges = [PoseGraphEdge(a, b, motion, is_certain=True) for a, b in ((3, 1), (4, 3), (0, 2))]
    assert find_components(6, edges) == [[1, 3, 4], [0, 2], [5]]


# -- real scans ------------------------------------------------------------------------------------------


def test_a_real_street_of_stereo_pairs(shared_data: Path) -> None:
    frames = [
        replace(frame, color=result.color, depth=result.depth, right=None)
        for frame, result in depth_scan(
            select_frames(read_scan(shared_data / "stereo" / "kitti_sequence_1"), 12, 20)
        )
        if isinstance(result, DepthMap)
    ]
    found = register(hide_poses(frames))
    assert found.frame_indices == tuple(range(len(frames)))
    steps = compute_motion_errors(found.frames, frames)
    # The ground truth itself has rotation errors in the first dozen frames, so these are skipped.
    assert compute_rms([compute_rotation_angle(step) for step in steps]) < np.radians(0.05)
    assert compute_rms([float(np.linalg.norm(step[:3, 3])) for step in steps]) < 0.03
    # True poses are not degraded.
    kept = register(frames, refine=True)
    assert compute_trajectory_error(kept, frames) < 0.01


def test_a_real_desk_with_a_rotating_camera(shared_data: Path) -> None:
    frames = list(read_scan(shared_data / "real" / "rgbd_dataset_freiburg1_rpy").frames[::2])
    found = register(hide_poses(frames))
    assert len(found.frames) == len(frames)
    assert compute_trajectory_error(found, frames) < 0.015


def test_a_real_kitchen_with_its_poses_hidden(shared_data: Path) -> None:
    truth = list(read_scan(shared_data / "rgbd" / "7scenes_redkitchen").frames[:30:2])
    found = register(hide_poses(truth))
    assert len(found.frames) == len(truth)
    assert compute_trajectory_error(found, truth) < 0.03


def test_a_real_kitchen_without_colours(shared_data: Path) -> None:
    truth = list(read_scan(shared_data / "rgbd" / "7scenes_redkitchen").frames[:30:2])
    found = register([replace(frame, color=None) for frame in hide_poses(truth)])
    assert len(found.frames) == len(truth)
    assert compute_trajectory_error(found, truth) < 0.03


def test_a_real_table_top_whose_depth_has_a_grid_of_holes(shared_data: Path) -> None:
    truth = list(read_scan(shared_data / "rgbd" / "tabletop_box_realsense").frames[::2])
    found = register(hide_poses(truth))
    assert len(found.frames) == len(truth)
    assert compute_trajectory_error(found, truth) < 0.02 * compute_path_length(truth)


def select_frames(scan: Scan, first: int, last: int) -> Scan:
    return replace(scan, frames=scan.frames[first:last])


def compute_motion_errors(found: Sequence[Frame], truth: Sequence[Frame]) -> list[Pose]:
    """Compute the differences between estimated and true motions of consecutive frames."""
    pairs = itertools.pairwise(zip(found, truth, strict=True))
    return [
        invert_pose(invert_pose(a.world_from_camera) @ b.world_from_camera)
        @ invert_pose(one.world_from_camera)
        @ other.world_from_camera
        for (one, a), (other, b) in pairs
    ]


def compute_rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def disturb_poses(frames: Sequence[Frame]) -> list[Frame]:
    """Disturb poses randomly by 2 cm and 0.5°."""
    rng = np.random.default_rng(5)
    rough = []
    for frame in frames:
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(rng.normal(0, np.radians(0.5), 3))[0]
        pose[:3, 3] = rng.normal(0, 0.02, 3)
        rough.append(replace(frame, world_from_camera=frame.world_from_camera @ pose))
    return rough


def add_moving_board(frames: Sequence[Frame]) -> list[Frame]:
    """Add a board in front of the scene that swings from side to side."""
    board = np.random.default_rng(2).integers(0, 255, (24, 8, 3)).repeat(8, axis=0).repeat(8, axis=1)
    board = np.asarray(cv2.GaussianBlur(board.astype(np.uint8), (0, 0), 1.5), np.uint8)
    with_it = []
    for i, frame in enumerate(frames):
        color, depth = read_color(frame), read_depth(frame)
        left = round((frame.camera.width - 64) * (0.5 + 0.4 * np.sin(0.7 * i)))
        color[-192:, left : left + 64] = board
        depth[-192:, left : left + 64] = 0.6 * np.median(depth[depth > 0])
        with_it.append(replace(frame, color=color, depth=depth, depth_scale=1.0))
    return with_it


def render_corner(number: int) -> Frame:
    """Render a view into an empty corner, from a slightly different position for each number."""
    rays = compute_rays(CAMERA)
    origin = np.array([0.01 * number, 0.008 * number, 0.0])
    # Three walls, each with a normal towards the camera and a distance.
    walls = [((0, 0, -1), 1.0), ((-1, 0, -0.3), 0.5), ((0, -1, -0.2), 0.4)]
    depth = np.full(rays.shape[:2], np.inf)
    for normal, distance in walls:
        n = np.array(normal) / np.linalg.norm(normal)
        towards = rays @ n
        hit = np.where(towards < 0, (-distance - origin @ n) / np.where(towards < 0, towards, 1), np.inf)
        depth = np.minimum(depth, np.where(hit > 0, hit, np.inf))
    pose: Pose = np.eye(4)
    pose[:3, 3] = origin
    return Frame(f"room {number}", CAMERA, depth=depth.astype(np.float32), world_from_camera=pose)


def compute_rays(camera: Camera) -> NDArray[np.float64]:
    rows, columns = np.mgrid[: camera.height, : camera.width]
    return np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(rows.shape)], axis=2
    )


def test_the_sample_meets_the_assumptions_of_these_tests() -> None:
    frame = read_sample()[0]
    assert read_depth(frame).shape == (240, 320)
    assert read_color(frame).shape == (240, 320, 3)
