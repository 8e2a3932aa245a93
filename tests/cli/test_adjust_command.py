"""The command `adjust`: what it writes, what it says, and what it refuses."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stages.adjusting.cameras import motion

pytestmark = pytest.mark.slow

Run = Callable[..., Any]
SAMPLES = Path(__file__).parents[2] / "samples"


def test_better_poses_are_written_and_used_by_fuse(scanloom: Run, tmp_path: Path) -> None:
    scan = tmp_path / "scan"
    shutil.copytree(SAMPLES / "rgbd", scan)
    listed = json.loads((scan / "scan.json").read_text())
    rng = np.random.default_rng(7)
    for frame in listed["frames"]:
        step = motion(rng.normal(size=(1, 6)) * np.array([0.005] * 3 + [0.005] * 3))[0]
        frame["world_from_camera"] = (np.array(frame["world_from_camera"]) @ step).tolist()
    (scan / "scan.json").write_text(json.dumps(listed))
    before = (scan / "scan.json").read_bytes()
    ran = scanloom("adjust", scan, tmp_path / "better", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["accepted"]
    assert ran.json["transfer_after"]["median_px"] < 0.5 < ran.json["transfer_before"]["median_px"]
    assert ran.json["frames_adjusted"] == 24
    assert {path.name for path in (tmp_path / "better").iterdir()} == {"cameras.json", "trajectory.tum"}
    assert (scan / "scan.json").read_bytes() == before
    poses = ("--poses", tmp_path / "better" / "trajectory.tum")
    fused = scanloom("fuse", scan, tmp_path / "fused.ply", *poses, "--voxel-size", 0.03, "--json")
    assert fused.exit_code == 0, fused.stderr


def test_exact_poses_are_said_to_be(scanloom: Run, tmp_path: Path) -> None:
    ran = scanloom("adjust", SAMPLES / "rgbd", tmp_path / "better")
    assert ran.exit_code == 0, ran.stderr
    assert "left as given: colour, depth and poses agree to 0." in ran.stdout
    assert [path.name for path in (tmp_path / "better").iterdir()] == ["cameras.json"]


def test_pairs_are_refused_with_the_way(scanloom: Run, tmp_path: Path) -> None:
    ran = scanloom("adjust", SAMPLES / "stereo", tmp_path / "better")
    assert ran.exit_code == 3
    assert "scanloom depth" in ran.stderr
