"""Estimation of an unknown focal length, compared with the hidden true value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import turntable_object

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.inspecting.inspect import inspect
from scanloom.stages.registration.focal_length import estimate_focal_length, has_guessed_camera
from scanloom.stages.registration.focal_length_from_marks import estimate_focal_length_from_marks
from scanloom.stages.registration.register import register
from scanloom.stages.scans.calibration.camera_resolution import find_or_guess_camera
from scanloom.stages.scans.codes import CAMERA_INTRINSICS_GUESSED
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.scans.reader import read_scan

pytestmark = pytest.mark.slow

SAMPLE = Path(__file__).parents[3] / "samples" / "rgbd"


def hide_camera(frames: Sequence[Frame], focal: float) -> list[Frame]:
    """Replace the camera by a guess and remove poses."""
    height, width = frames[0].camera.height, frames[0].camera.width
    guess = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, is_guess=True)
    return [replace(frame, camera=guess, color_camera=None, world_from_camera=None) for frame in frames]


def test_the_focal_length_of_the_sample_is_estimated() -> None:
    frames = list(read_scan(SAMPLE).frames[::2])
    truth = frames[0].camera.fx
    found = estimate_focal_length(hide_camera(frames, 1.15 * truth))
    assert found is not None
    assert found.focal_px == pytest.approx(truth, rel=0.005)
    assert found.error_px < 0.005 * truth


@pytest.mark.parametrize(
    ("name", "guess", "truth", "within"),
    [
        ("real/rgbd_dataset_freiburg1_rpy", 525, 517, 0.015),
        ("real/realsense_box_open3d_json", 525, 617.4, 0.06),
    ],
)
def test_focal_lengths_of_public_scans_are_estimated(
    shared_data: Path, name: str, guess: float, truth: float, within: float
) -> None:
    found = estimate_focal_length(hide_camera(read_scan(shared_data / name, complete=False).frames, guess))
    assert found is not None
    assert found.focal_px == pytest.approx(truth, rel=within)


def test_turning_marks_give_the_focal_length_without_other_parallax(shared_data: Path) -> None:
    frames = read_scan(shared_data / "rgbd/turntable_d435_data1", complete=False).frames
    assert estimate_focal_length(frames) is None
    found = estimate_focal_length_from_marks(frames[1:])
    assert found is not None
    assert found.focal_px == pytest.approx(617, rel=0.04)


def test_the_focal_length_of_a_phone_is_plausible(shared_data: Path) -> None:
    frames = read_scan(shared_data / "real/phone_desk_no_calibration", complete=False).frames
    assert has_guessed_camera(frames)
    assert (frames[0].camera.fx, frames[0].camera.fy) == (187, 187)
    found = estimate_focal_length(hide_camera(frames, 157.5))
    assert found is not None
    assert found.focal_px == pytest.approx(187, rel=0.02)


def test_too_few_features_give_no_focal_length() -> None:
    assert estimate_focal_length(hide_camera(turntable_object.frames([0.0] * 3), 250)) is None
    assert estimate_focal_length(hide_camera(turntable_object.frames([0.0], texture=1), 250)) is None


def test_registration_uses_and_returns_the_estimated_focal_length() -> None:
    frames = list(read_scan(SAMPLE).frames[::3])
    truth = frames[0].camera.fx
    found = register(hide_camera(frames, 0.9 * truth), loops=False)
    assert found.focal_estimate is not None
    assert all(frame.camera.fx == found.focal_estimate.focal_px for frame in found.frames)
    assert not found.frames[0].camera.is_guess
    assert found.to_dict()["focal"]["guess_px"] == 0.9 * truth
    assert any("the focal length is estimated to be" in str(one) for one in found.diagnostics)
    kept = register(hide_camera(frames, 0.9 * truth), focal=False, loops=False)
    assert kept.focal_estimate is None
    assert kept.frames[0].camera.fx == 0.9 * truth


def test_a_given_focal_length_is_not_estimated() -> None:
    frames = [replace(frame, world_from_camera=None) for frame in read_scan(SAMPLE).frames[::4]]
    assert not has_guessed_camera(frames)
    assert register(frames, loops=False).focal_estimate is None


def test_inspect_reports_an_unknown_focal_length() -> None:
    found = inspect(Scan("made", hide_camera(turntable_object.frames([0.0, 0.0]), 250)))
    assert found.to_dict()["focal"] is None
    assert any("the guess of 250 px is used" in str(one) for one in found.diagnostics)


@pytest.mark.parametrize(("size", "focal"), [((256, 192), 187), ((192, 256), 187), ((640, 480), 525)])
def test_the_guess_is_for_a_phone_or_a_kinect(tmp_path: Path, size: tuple[int, int], focal: float) -> None:
    with collecting() as diagnostics:
        camera, _ = find_or_guess_camera(tmp_path, *size)
    assert (camera.fx, camera.fy, camera.is_guess) == (focal, focal, True)
    assert [one.code for one in diagnostics] == [CAMERA_INTRINSICS_GUESSED.name]
    assert ("LiDAR" in str(diagnostics[0])) == (focal == 187)
