"""A run on a scan without poses: they are found once, kept, and used by what comes after."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from pipeline.config import Config
from pipeline.run import run
from stages.errors import InputError, UsageError
from stages.formats.ply import read_ply
from stages.formats.trajectories import read_tum
from stages.layouts import read_scan

SAMPLE = Path(__file__).parents[2] / "samples" / "rgbd"
QUICK = ("scan.every=3", "fuse.voxel_size=0.02", "simplify.ratio=0.2")


@pytest.fixture(scope="module")
def unposed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unposed") / "scan"
    shutil.copytree(SAMPLE, folder)
    document = json.loads((folder / "scan.json").read_text())
    for frame in document["frames"]:
        frame["world_from_camera"] = None
    (folder / "scan.json").write_text(json.dumps(document))
    return folder


def config(*more: str) -> Config:
    return Config().set([*QUICK, *more])


def test_poses_are_found_kept_and_fused_with(unposed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = run(unposed, out, config())
    assert [outcome.stage for outcome in first.stages][:2] == ["register", "fuse"]
    truth = read_scan(SAMPLE).frames[::3]
    found = read_tum(out / "trajectory.tum").poses
    assert len(found) == len(truth)
    into = truth[0].world_from_camera
    off = [
        np.linalg.norm((into @ pose - true.world_from_camera)[:3, 3])
        for pose, true in zip(found, truth, strict=True)
    ]
    assert max(off) < 0.01
    assert (out / "path.ply").stat().st_size > 100_000
    mesh = read_ply(out / "fused.ply")
    assert len(mesh.triangles) > 1000
    register = json.loads((out / "report.json").read_text())["stages"]["register"]
    assert register["figures"]["frames"] == len(truth)
    assert register["figures"]["pieces"] == [len(truth)]

    again = run(unposed, out, config("fuse.voxel_size=0.03"))
    assert [outcome.cached for outcome in again.stages][:2] == [True, False]


def test_a_scan_with_poses_has_no_such_stage_unless_asked_for(tmp_path: Path) -> None:
    plain = run(SAMPLE, tmp_path / "plain", config(), until="fuse")
    assert [outcome.stage for outcome in plain.stages] == ["fuse"]
    with pytest.raises(UsageError, match="register is not a stage of this scan: its frames have poses"):
        run(SAMPLE, tmp_path / "no", config(), until="register")
    anew = run(SAMPLE, tmp_path / "anew", config("register.enabled=true"), until="register")
    assert [outcome.stage for outcome in anew.stages] == ["register"]


def test_a_scan_without_poses_is_refused_where_it_is_switched_off(unposed: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no poses: .*scan\.poses=FILE"):
        run(unposed, tmp_path / "out", config("register.enabled=false"))
