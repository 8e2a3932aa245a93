"""A run on a scan with inaccurate poses and colour camera.

Corrections are computed once, cached, written and used.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scanloom import adjust
from scanloom.pipeline.artifacts.adjusted_cameras import apply_adjusted, write_adjusted
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.adjusting.cameras import compute_motions
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.scans.model.depth_correction import COEFFICIENT_COUNT, DepthCorrection
from scanloom.stages.scans.model.images import read_color
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.trajectory.trajectory_formats import read_tum
from scanloom.stages.scans.transforms.adjusted_cameras import apply_adjusted_cameras
from scanloom.stages.scans.transforms.depth_calibration import read_depth_calibration

pytestmark = pytest.mark.slow

SAMPLE = Path(__file__).parents[2] / "samples" / "rgbd"
QUICK = ("fuse.voxel_size=0.02", "scan.every=2")


def config(*more: str) -> Config:
    return Config().set([*QUICK, *more])


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the sample with pose errors of about 1 cm and 0.5°."""
    folder = tmp_path_factory.mktemp("disturbed") / "scan"
    shutil.copytree(SAMPLE, folder)
    document = json.loads((folder / "scan.json").read_text())
    rng = np.random.default_rng(2)
    for frame in document["frames"]:
        step = rng.normal(size=(1, 6)) * np.array([0.006] * 3 + [np.radians(0.3)] * 3)
        frame["world_from_camera"] = (
            np.array(frame["world_from_camera"]) @ compute_motions(step)[0]
        ).tolist()
    (folder / "scan.json").write_text(json.dumps(document))
    return folder


def test_adjusted_poses_are_written_cached_and_used_for_fusion(disturbed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = run(disturbed, out, config(), until="fuse")
    assert [outcome.stage for outcome in first.stages] == ["adjust", "fuse"]
    metrics = first.report["stages"]["adjust"]["metrics"]
    assert metrics["accepted"]
    assert metrics["transfer_after"]["median_px"] < 0.4 < 2 < metrics["transfer_before"]["median_px"]
    document = json.loads((out / "adjusted" / "cameras.json").read_text())
    written = read_tum(out / "adjusted" / "trajectory.tum").poses
    assert len(written) == len(document["poses"]) == 12
    for pose, other in zip(written, document["poses"].values(), strict=True):
        np.testing.assert_allclose(pose, other, atol=1e-6)

    again = run(disturbed, out, config("fuse.voxel_size=0.03"), until="fuse")
    assert [outcome.cached for outcome in again.stages] == [True, False]
    off = run(disturbed, tmp_path / "off", config("adjust.enabled=false"), until="fuse")
    assert [outcome.stage for outcome in off.stages] == ["fuse"]
    fused = [one.report["stages"]["fuse"]["metrics"]["triangles"] for one in (first, off)]
    assert fused[0] != fused[1]
    with pytest.raises(UsageError, match="adjust is switched off"):
        run(disturbed, tmp_path / "no", config("adjust.enabled=false"), until="adjust")


def test_exact_poses_are_unchanged(tmp_path: Path) -> None:
    made = run(SAMPLE, tmp_path / "out", config(), until="adjust")
    assert not made.report["stages"]["adjust"]["metrics"]["accepted"]
    assert not (tmp_path / "out" / "adjusted").exists()
    why = made.report["stages"]["adjust"]["metrics"]["why"]
    assert why.startswith("left as given: colour, depth and poses agree to 0.")


def test_written_cameras_restore_the_frames_bit_for_bit(disturbed: Path, tmp_path: Path) -> None:
    scan = read_scan(disturbed)
    scan = replace(scan, frames=scan.frames[::2])
    found = adjust(scan, camera=True)
    assert found.is_camera_adjusted
    write_adjusted(tmp_path, found)
    read = apply_adjusted(scan, tmp_path)
    for one, other in zip(read.frames, found.frames, strict=True):
        np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
        np.testing.assert_array_equal(one.color_from_depth, other.color_from_depth)
        assert one.color_camera == other.color_camera
        assert one.shutter_turn is None


def test_a_depth_correction_is_written_and_read_again(disturbed: Path, tmp_path: Path) -> None:
    scan = read_scan(disturbed)
    scan = replace(scan, frames=scan.frames[:4])
    correction = DepthCorrection(320, 240, 0.5, 2.0, (0.01, *[0.001] * (COEFFICIENT_COUNT - 1)))
    frames = tuple(replace(frame, depth_correction=correction) for frame in scan.frames)
    found = replace(
        adjust(scan), frames=frames, adjusted_indices=(0, 2), accepted=True, depth_correction=correction
    )
    write_adjusted(tmp_path, found)
    assert read_depth_calibration(tmp_path / "depth_calibration.json") == correction
    for read in (apply_adjusted(scan, tmp_path), apply_adjusted_cameras(scan, tmp_path / "cameras.json")):
        assert {frame.depth_correction for frame in read.frames} == {correction}


def test_written_shutter_turns_are_read_back(disturbed: Path, tmp_path: Path) -> None:
    scan = read_scan(disturbed)
    scan = replace(scan, frames=scan.frames[:4])
    turns = np.random.default_rng(5).normal(size=(4, 3)) / 50
    frames = [replace(frame, shutter_turn=turn) for frame, turn in zip(scan.frames, turns, strict=True)]
    found = replace(
        adjust(scan), frames=tuple(frames), adjusted_indices=(0, 2), accepted=True, is_shutter_adjusted=True
    )
    write_adjusted(tmp_path, found)
    placed = apply_adjusted(scan, tmp_path).frames
    by_name = apply_adjusted_cameras(scan, tmp_path / "cameras.json").frames
    for frames in (placed, by_name):
        for number in (0, 2):
            np.testing.assert_array_equal(frames[number].shutter_turn, turns[number])
        assert frames[1].shutter_turn is None


@pytest.mark.parametrize("wrong", [[0.1, 0.2], [1, 1, 1], ["x", 0, 0], {"a": 1}, [float("nan"), 0, 0]])
def test_an_invalid_shutter_turn_is_an_error(disturbed: Path, tmp_path: Path, wrong: object) -> None:
    scan = read_scan(disturbed)
    name = scan.frames[0].name
    pose = scan.frames[0].world_from_camera.tolist()
    document = {"accepted": True, "names": {"0": name}, "poses": {"0": pose}, "shutter_turns": {"0": wrong}}
    (tmp_path / "cameras.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"shutter_turn must be a rotation vector|NaN"):
        apply_adjusted_cameras(scan, tmp_path / "cameras.json")


def test_shutter_turns_of_unknown_frames_are_an_error(disturbed: Path, tmp_path: Path) -> None:
    document = {"accepted": True, "names": {}, "poses": {}, "shutter_turns": {"0": [0, 0, 0]}}
    (tmp_path / "cameras.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="the names of its frames are missing"):
        apply_adjusted_cameras(read_scan(disturbed), tmp_path / "cameras.json")


def test_a_colour_camera_without_poses_is_written_and_read_back(tmp_path: Path) -> None:
    scan = read_scan(SAMPLE)
    moved = [replace(frame, color=np.roll(read_color(frame), 4, axis=1)) for frame in scan.frames]
    # The first frame has no pose and is not used; its colour camera differs from the estimated one.
    moved[0] = replace(moved[0], world_from_camera=None, color_from_depth=np.diag([-1.0, -1, 1, 1]))
    found = adjust(moved)
    assert found.accepted
    assert found.camera_after.cx == pytest.approx(scan.frames[0].camera.cx + 4, abs=0.35)
    assert not found.adjusted_indices
    write_adjusted(tmp_path, found)
    assert not (tmp_path / "trajectory.tum").exists()
    for read in (apply_adjusted(scan, tmp_path), apply_adjusted_cameras(scan, tmp_path / "cameras.json")):
        for one, other, given in list(zip(read.frames, found.frames, scan.frames, strict=True))[1:]:
            assert one.color_camera == other.color_camera
            np.testing.assert_array_equal(one.color_from_depth, np.eye(4))
            np.testing.assert_array_equal(one.world_from_camera, given.world_from_camera)
