"""A run repeats at its end that its camera is guessed."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scanloom.stages.scans.reader import read_scan

Run = Callable[..., Any]


def test_a_run_ends_with_the_guess_unless_the_camera_is_given(
    scanloom: Run, tiny_scan: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "scan"
    poses = []
    for number, frame in enumerate(read_scan(tiny_scan).frames):
        for kind in ("color", "depth"):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            shutil.copy(getattr(frame, kind), folder / kind / f"{number}.png")
        assert frame.world_from_camera is not None
        rows = "\n".join(" ".join(map(str, row)) for row in frame.world_from_camera)
        poses.append(f"{number} {number} {number + 1}\n{rows}\n")
    (folder / "trajectory.log").write_text("".join(poses))
    words = ("run", folder, "-o", tmp_path / "out", "--until", "fuse", "--quiet")
    last = scanloom(*words, "--set", "scan.check_poses=false").stdout.splitlines()[-2]
    assert last.startswith("the camera is a guess: ")
    assert "--intrinsics=NAME (such as d435, azure or kinect2)" in last
    named = scanloom(*words, "--set", "scan.check_poses=false", "--intrinsics", "kinect1")
    assert named.exit_code == 0, named.stderr
    assert "the camera is a guess" not in named.stdout
