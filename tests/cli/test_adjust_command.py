"""Command `adjust`: written files, messages and refused input."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom import InputError, ScanParams, read_scan
from scanloom.stages.adjusting.cameras import compute_motions
from scanloom.stages.scans.model.scan import Camera

pytestmark = pytest.mark.slow

Run = Callable[..., Any]
SAMPLES = Path(__file__).parents[2] / "samples"


@pytest.mark.slow
def test_fuse_uses_the_poses_written_by_adjust(scanloom: Run, tmp_path: Path) -> None:
    scan = tmp_path / "scan"
    shutil.copytree(SAMPLES / "rgbd", scan)
    listed = json.loads((scan / "scan.json").read_text())
    listed["frames"] = listed["frames"][::3]
    rng = np.random.default_rng(7)
    for frame in listed["frames"]:
        step = compute_motions(rng.normal(size=(1, 6)) * np.array([0.005] * 3 + [0.005] * 3))[0]
        frame["world_from_camera"] = (np.array(frame["world_from_camera"]) @ step).tolist()
    (scan / "scan.json").write_text(json.dumps(listed))
    before = (scan / "scan.json").read_bytes()
    ran = scanloom("adjust", scan, tmp_path / "better", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["accepted"]
    assert ran.json["transfer_after"]["median_px"] < 0.5 < ran.json["transfer_before"]["median_px"]
    assert ran.json["frames_adjusted"] == 8
    assert {path.name for path in (tmp_path / "better").iterdir()} == {"cameras.json", "trajectory.tum"}
    assert (scan / "scan.json").read_bytes() == before
    poses = ("--poses", tmp_path / "better" / "trajectory.tum")
    fused = scanloom("fuse", scan, tmp_path / "fused.ply", *poses, "--voxel-size", 0.03, "--json")
    assert fused.exit_code == 0, fused.stderr

    # Poses and cameras of the first run leave nothing to improve.
    found = ("--set", f"scan.adjusted_cameras={tmp_path}/better/cameras.json")
    again = scanloom("adjust", scan, tmp_path / "again", *found, "--json")
    assert not again.json["accepted"]
    assert again.json["transfer_before"]["median_px"] < 0.5


def test_an_adjusted_colour_camera_is_read_from_cameras_json(tmp_path: Path) -> None:
    names = [f"{place:04d}" for place in range(24)]
    camera = asdict(Camera(320, 240, 300.0, 300.0, 160.0, 120.0, (0.01, 0, 0, 0)))
    beside = np.eye(4)
    beside[0, 3] = 0.02
    document = {
        "accepted": True,
        "color_camera": camera,
        "color_from_depth": beside.tolist(),
        "names": {"3": names[3]},
        "poses": {"3": np.eye(4).tolist()},
    }
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(document))
    given = read_scan(SAMPLES / "rgbd")
    scan = read_scan(SAMPLES / "rgbd", ScanParams(adjusted_cameras=str(path), first=2))
    assert np.array_equal(scan.frames[1].world_from_camera, np.eye(4))
    assert np.array_equal(scan.frames[0].world_from_camera, given.frames[2].world_from_camera)
    assert {frame.color_camera.fx for frame in scan.frames} == {300.0}
    assert all(np.array_equal(frame.color_from_depth, beside) for frame in scan.frames)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"accepted": None}, "a cameras.json of `scanloom adjust` is expected"),
        ({"names": {}}, "the names of its frames are missing"),
        ({"poses": {"3": [[1, 2], [3, 4]]}}, "not a 4x4 matrix"),
        ({"poses": {"3": np.full((4, 4), np.nan).tolist()}}, "frame 0003"),
        ({"color_camera": [1]}, "color_camera must be a table"),
        ({"color_camera": {"width": 3}}, "width and height"),
        ({"names": {"3": 3}}, "not a string"),
        ({"names": {"3": "another"}}, "it belongs to another scan"),
    ],
)
def test_a_damaged_cameras_json_is_reported(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    document = {"accepted": True, "color_camera": None, "color_from_depth": None}
    document |= {"names": {"3": "0003"}, "poses": {"3": np.eye(4).tolist()}} | change
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=message):
        read_scan(SAMPLES / "rgbd", ScanParams(adjusted_cameras=str(path)))


def test_exact_poses_are_reported_and_left_as_given(scanloom: Run, tmp_path: Path) -> None:
    ran = scanloom("adjust", SAMPLES / "rgbd", tmp_path / "better")
    assert ran.exit_code == 0, ran.stderr
    assert "left as given: colour, depth and poses agree to 0." in ran.stdout
    assert [path.name for path in (tmp_path / "better").iterdir()] == ["cameras.json"]


def test_a_damaged_depth_calibration_is_one_error(scanloom: Run, tmp_path: Path) -> None:
    path = tmp_path / "depth_calibration.json"
    path.write_text('{"version": 1, "near_m": 1, "coefficients": []}')
    ran = scanloom("inspect", SAMPLES / "rgbd", "--set", f"scan.depth_calibration={path}")
    assert ran.exit_code == 3
    assert ran.stderr.count("depth_calibration.json: a depth calibration needs") == 1
    assert "Traceback" not in ran.stderr


def test_stereo_pairs_are_refused_with_a_remedy(scanloom: Run, tmp_path: Path) -> None:
    ran = scanloom("adjust", SAMPLES / "stereo", tmp_path / "better")
    assert ran.exit_code == 3
    assert "scanloom depth" in ran.stderr
