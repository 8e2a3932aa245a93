"""Exact poses of the sample are kept, disturbed poses are recovered, and unusable input is reported."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom import Frame, adjust, read_scan
from scanloom.stages.adjusting.cameras import compute_motions, compute_pose_distance, decompose_motions
from scanloom.stages.adjusting.codes import ADJUST_IMAGES_MISMATCH
from scanloom.stages.adjusting.key_frames import select_key_frames
from scanloom.stages.scans.model.images import read_color, read_depth

SAMPLE = Path(__file__).parents[3] / "samples" / "rgbd"


@pytest.fixture(scope="module")
def frames() -> Sequence[Frame]:
    return read_scan(SAMPLE).frames


@pytest.fixture(scope="module")
def half(frames: Sequence[Frame]) -> Sequence[Frame]:
    """Take every other frame: the same trajectory with doubled steps, for a third of the time."""
    return frames[::2]


def disturb_frames(frames: Sequence[Frame], metres: float, degrees: float, zoom: float = 1.0) -> list[Frame]:
    """Add random errors of this size to poses, and scale the focal length of the colour camera."""
    rng = np.random.default_rng(1)
    scale = np.array([metres] * 3 + [np.radians(degrees)] * 3) / np.sqrt(3)
    result = []
    for frame in frames:
        camera = replace(frame.camera, fx=zoom * frame.camera.fx, fy=zoom * frame.camera.fy)
        pose = frame.world_from_camera @ compute_motions(rng.normal(size=(1, 6)) * scale)[0]
        result.append(replace(frame, world_from_camera=pose, color_camera=camera if zoom != 1 else None))
    return result


def render_rolling_shutter(frames: Sequence[Frame], degrees: float) -> tuple[list[Frame], np.ndarray]:
    """Render frames with a rolling shutter and rotating cameras; return the rotations as well."""
    turns = np.radians(degrees) * np.random.default_rng(7).normal(size=(len(frames), 3))
    turns -= turns.mean(axis=0)
    result = []
    for frame, turn in zip(frames, turns, strict=True):
        camera = frame.camera
        v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
        steps = np.concatenate(
            [np.zeros((camera.height, 3)), ((v[:, :1] + 0.5) / camera.height - 0.5) * turn], axis=1
        )
        x, y, z = np.einsum("rij,rcj->cri", compute_motions(steps)[:, :3, :3], rays).transpose(2, 1, 0)
        where = [
            (f * one / z + c).astype(np.float32)
            for f, one, c in ((camera.fx, x, camera.cx), (camera.fy, y, camera.cy))
        ]
        color = cv2.remap(read_color(frame), *where, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        depth = cv2.remap(read_depth(frame), *where, cv2.INTER_NEAREST) / z.astype(np.float32)
        result.append(replace(frame, color=color, depth=depth))
    return result, turns


def measure_relative_errors(frames: Sequence[Frame], others: Sequence[Frame]) -> np.ndarray:
    """Compute differences of relative motions between consecutive frames, (n, 2) metres and degrees.

    Independent of the world frame.
    """
    both = [[one.world_from_camera for one in some] for some in (frames, others)]
    steps = [[np.linalg.inv(a) @ b for a, b in itertools.pairwise(poses)] for poses in both]
    return np.array([compute_pose_distance(a, b) for a, b in zip(*steps, strict=True)])


def measure_trajectory_error(frames: Sequence[Frame], others: Sequence[Frame]) -> float:
    """Compute the RMS distance of camera centres after the best rigid motion (Umeyama), metres."""
    a, b = (np.stack([one.world_from_camera[:3, 3] for one in some]) for some in (frames, others))
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return float(np.sqrt(((a - b @ turn.T) ** 2).sum(axis=1).mean()))


@pytest.mark.slow
def test_exact_poses_are_kept(frames):
    told: list[int] = []
    found = adjust(frames, progress=lambda done, _: told.append(done))
    assert len(set(told)) >= 10, "checks of a sample take long, and progress moves"
    assert told == sorted(told)
    assert not found.accepted
    assert "agree to 0." in found.reason
    assert found.error_before.median < 0.5
    assert list(map(id, found.frames)) == list(map(id, frames))


@pytest.mark.slow
def test_disturbed_poses_are_recovered(half):
    disturbed = disturb_frames(half, 0.01, 0.5)
    told: list[tuple[int, int]] = []
    found = adjust(disturbed, progress=lambda done, total: told.append((done, total)))
    assert found.accepted
    assert not found.is_camera_adjusted, "the given camera is right"
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert {total for _, total in told} == {told[-1][0]}
    assert found.error_after.median < 0.3 < 2 < found.error_before.median
    was, is_now = (
        np.median(measure_relative_errors(half, some), axis=0) for some in (disturbed, found.frames)
    )
    assert is_now[0] < 0.2 * was[0]
    assert is_now[1] < 0.15 * was[1]
    assert all(frame.color_camera is None for frame in found.frames)


@pytest.mark.slow
def test_a_wrong_focal_length_is_recovered_with_the_poses(half):
    disturbed = disturb_frames(half, 0.01, 0.5, zoom=1.05)
    found = adjust(disturbed)
    assert found.accepted
    assert found.is_camera_adjusted
    assert found.error_after.median < 0.3
    camera = found.frames[0].color_camera
    assert camera.fx == pytest.approx(half[0].camera.fx, rel=0.005)
    assert camera.distortion[1:] == (0, 0, 0) or camera.distortion == ()
    assert (camera.width, camera.height) == (320, 240)
    assert np.linalg.norm(found.frames[0].color_from_depth[:3, 3]) < 0.004
    assert np.median(measure_relative_errors(half, found.frames), axis=0)[0] < 0.002
    assert found.camera_before.fx == pytest.approx(1.05 * half[0].camera.fx)


@pytest.mark.slow
def test_rolling_shutter_rotations_are_estimated_with_the_poses(half):
    made, turns = render_rolling_shutter(half, 1.0)
    disturbed = disturb_frames(made, 0.006, 0.3)
    found = adjust(disturbed)
    assert found.is_shutter_adjusted
    assert "rolling shutter" in found.reason
    assert found.to_dict()["shutter_rotation_median_deg"] == pytest.approx(
        np.median(np.degrees(np.linalg.norm(turns, axis=1))), rel=0.25
    )
    told = np.stack([frame.shutter_turn for frame in found.frames])
    assert np.linalg.norm(told - turns) < 0.3 * np.linalg.norm(turns)
    assert np.median(measure_relative_errors(half, found.frames), axis=0)[0] < 0.003
    at_once = adjust(disturbed, shutter=False)
    assert not at_once.is_shutter_adjusted
    assert all(frame.shutter_turn is None for frame in at_once.frames)
    assert found.error_after.median < 0.6 * at_once.error_after.median
    # Frames with a known rolling shutter are adjusted from their corrected state.
    again = adjust(list(found.frames))
    assert not again.accepted


@pytest.mark.slow
def test_global_shutter_frames_get_negligible_rotations(half):
    found = adjust(disturb_frames(half, 0.01, 0.5), shutter=True)
    assert found.is_shutter_adjusted
    assert found.readout_rotation_deg[0] < 0.1
    assert found.error_after.median < 0.3


@pytest.mark.slow
def test_frames_between_keyframes_get_shutter_rotations(frames, monkeypatch):
    monkeypatch.setattr("scanloom.stages.adjusting.adjust._MAX_KEY_FRAMES", 8)
    made, turns = render_rolling_shutter(frames[:14], 1.0)
    found = adjust(disturb_frames(made, 0.004, 0.2))
    assert found.key_frame_count == 8
    assert found.is_shutter_adjusted
    told = np.stack([frame.shutter_turn for frame in found.frames])
    assert np.linalg.norm(told - turns) < 0.5 * np.linalg.norm(turns)
    # With known rotations and shutter=False, frames between keyframes also keep their rotation.
    known = [replace(frame, shutter_turn=turn) for frame, turn in zip(made, turns, strict=True)]
    placed = adjust(disturb_frames(known, 0.006, 0.3), shutter=False)
    assert placed.unadjusted_count == 0
    assert all(a.shutter_turn is b.shutter_turn for a, b in zip(placed.frames, known, strict=True))
    assert np.median(measure_relative_errors(frames[:14], placed.frames), axis=0)[0] < 0.002


@pytest.mark.slow
def test_shutter_correction_improves_a_real_trajectory(shared_data):
    scan = read_scan(shared_data / "real" / "rgbd_dataset_freiburg1_rpy")
    found = adjust(scan)
    assert found.is_shutter_adjusted
    assert found.error_after.median < 1.5
    assert measure_trajectory_error(scan.frames, found.frames) < 0.014
    at_once = adjust(scan, shutter=False)
    assert measure_trajectory_error(scan.frames, at_once.frames) > 0.016
    assert found.error_after.median < 0.8 * at_once.error_after.median
    # Independent reference: times and poses give the angular velocity about the vertical and horizontal axes.
    turns, speeds = [], []
    for before, one, after in zip(found.frames, found.frames[1:], found.frames[2:], strict=False):
        step = np.linalg.inv(before.world_from_camera) @ after.world_from_camera
        speeds.append(decompose_motions(step[None])[0, 3:5] * 1e9 / (after.timestamp - before.timestamp))
        turns.append(one.shutter_turn[:2])
    turn, speed = np.ravel(turns), np.ravel(speeds)
    assert np.corrcoef(turn, speed)[0, 1] > 0.8
    assert (turn @ speed) / (speed @ speed) == pytest.approx(0.026, abs=0.006)


@pytest.mark.slow
def test_adjust_is_deterministic(frames):
    disturbed = disturb_frames(frames[:6], 0.01, 0.5, zoom=1.05)
    once, again = adjust(disturbed), adjust(disturbed)
    assert once.accepted
    for one, other in zip(once.frames, again.frames, strict=True):
        np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
        assert one.color_camera == other.color_camera


@pytest.mark.slow
def test_frames_between_keyframes_are_adjusted(frames, monkeypatch):
    monkeypatch.setattr("scanloom.stages.adjusting.adjust._MAX_KEY_FRAMES", 8)
    some = frames[:14]
    disturbed = disturb_frames(some, 0.006, 0.3)
    found = adjust(disturbed)
    assert found.key_frame_count == 8
    assert found.unadjusted_count == 0
    assert len(found.adjusted_indices) == len(some)
    was, is_now = (
        np.median(measure_relative_errors(some, those), axis=0) for those in (disturbed, found.frames)
    )
    assert is_now[0] < 0.4 * was[0]
    assert is_now[1] < 0.3 * was[1]


@pytest.mark.slow
def test_frames_that_cannot_be_used_keep_their_poses(half):
    disturbed = disturb_frames(half, 0.01, 0.5)
    dark = np.zeros((240, 320, 3), np.uint8)
    disturbed[5] = replace(disturbed[5], color=dark)
    disturbed[9] = replace(disturbed[9], world_from_camera=None)
    found = adjust(disturbed)
    assert found.accepted
    assert [(one.name, one.reason) for one in found.skipped] == [("0010", "its colour image is black")]
    assert found.frames[5].world_from_camera is disturbed[5].world_from_camera
    assert found.frames[9].world_from_camera is None
    assert found.unadjusted_count == 2
    assert not {5, 9} & set(found.adjusted_indices)


def test_black_frames_are_reported(frames):
    dark = [replace(frame, color=np.zeros((240, 320, 3), np.uint8)) for frame in frames[:4]]
    found = adjust(dark)
    assert not found.accepted
    assert found.reason.endswith("; 4 frames skipped: black colour image")
    assert found.diagnostics == (), "there is nothing in them that could be wrong"


def test_over_exposed_frames_are_reported(frames):
    white = [replace(frame, color=np.full((240, 320, 3), 255, np.uint8)) for frame in frames[:4]]
    assert "over-exposed" in adjust(white).reason


def test_frames_without_depth_are_reported(frames):
    bare = [replace(frame, depth=np.zeros((240, 320), np.float32)) for frame in frames[:4]]
    assert "no matched keypoint has depth" in adjust(bare).reason


@pytest.mark.slow
def test_the_estimated_camera_has_the_size_of_the_images(frames):
    some = disturb_frames(frames[:8], 0.01, 0.5, zoom=1.05)
    large = [replace(one, color=cv2.resize(read_color(one), (1280, 960))) for one in some]
    found = adjust(large, camera=True)
    camera = found.frames[0].color_camera
    assert (camera.width, camera.height) == (1280, 960)
    assert camera.fx == pytest.approx(4 * frames[0].camera.fx, rel=0.02)


@pytest.mark.slow
def test_colour_of_another_scene_is_reported_with_errors(frames):
    # Each frame gets the image of a frame from elsewhere.
    other = [replace(a, color=b.color) for a, b in zip(frames, reversed(frames), strict=True)]
    found = adjust(other)
    assert not found.accepted
    assert "keypoint matches" in found.reason


@pytest.mark.slow
def test_inverted_poses_are_reported_with_errors(half):
    other = [replace(one, world_from_camera=np.linalg.inv(one.world_from_camera)) for one in half]
    found = adjust(other)
    assert not found.accepted
    (diagnostic,) = found.diagnostics
    assert diagnostic.code == ADJUST_IMAGES_MISMATCH.name
    assert str(diagnostic).startswith("not adjusted: ")
    assert list(map(id, found.frames)) == list(map(id, other))


def test_too_few_frames_are_returned_unchanged(frames):
    found = adjust([replace(frame, world_from_camera=None) for frame in frames])
    assert found.reason == "left as given: fewer than two frames have colour, depth and a pose"
    assert found.to_dict()["transfer_before"] is None


def test_keyframes_are_spread_over_the_trajectory():
    poses = np.tile(np.eye(4), (100, 1, 1))
    poses[:, 0, 3] = np.concatenate([np.linspace(0, 0.01, 50), np.linspace(0.02, 1, 50)])
    chosen = select_key_frames(poses, 20)
    assert len(chosen) <= 20
    assert chosen[0] == 0
    assert chosen[-1] == 99
    assert (chosen >= 50).sum() > 3 * (chosen < 50).sum()
    assert select_key_frames(poses, 100).tolist() == list(range(100))
