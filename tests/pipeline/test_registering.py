"""A run on a scan without poses: poses are estimated once, cached, and used by later stages."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.trajectory.trajectory_formats import read_tum
from scanloom.stages.surface.formats.ply import read_ply

pytestmark = pytest.mark.slow

SAMPLE = Path(__file__).parents[2] / "samples" / "rgbd"
QUICK = (
    "scan.every=3",
    "fuse.voxel_size=0.02",
    "simplify.ratio=0.2",
    "compare.samples=1000",
    "report.viewpoints=1",
    "report.page=false",
    "report.width=64",
)


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


def test_poses_are_estimated_cached_and_used_for_fusion(unposed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = run(unposed, out, config())
    assert [outcome.stage for outcome in first.stages][:3] == ["register", "adjust", "fuse"]
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
    assert register["metrics"]["frames"] == len(truth)
    assert register["metrics"]["pieces"] == [len(truth)]
    assert first.unmet_requirements == ()

    again = run(unposed, out, config("fuse.voxel_size=0.03"), until="fuse")
    assert [outcome.cached for outcome in again.stages][:3] == [True, True, False]


def test_disconnected_components_are_fused_separately(unposed: Path, tmp_path: Path) -> None:
    folder = tmp_path / "scan"
    shutil.copytree(unposed, folder)
    frames = json.loads((folder / "scan.json").read_text())["frames"]
    for frame in frames[12:]:
        # A mirrored view shows a scene that matches no other frame.
        for image in (frame["color"], frame["depth"]):
            pixels = cv2.imread(str(folder / image), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(folder / image), pixels[:, ::-1])
    result = run(folder, tmp_path / "out", config("scan.every=2", "scan.last=17"), until="fuse")
    assert result.report["stages"]["register"]["metrics"]["pieces"] == [6, 3]
    # The largest connected component is used; the rest only causes a warning, which --strict makes an error.
    assert result.unmet_requirements == ()
    sentence = result.report["stages"]["register"]["diagnostics"][0]["message"]
    assert sentence.startswith("the frames form 2 pieces that could not be connected; piece 1 is used")
    assert len(read_tum(tmp_path / "out" / "pieces" / "trajectory-2.tum").poses) == 3
    apart = read_ply(tmp_path / "out" / "pieces" / "fused-2.ply")
    assert 1000 < len(apart.triangles) < len(read_ply(tmp_path / "out" / "fused.ply").triangles)
    said = [one["message"] for one in result.report["stages"]["fuse"]["diagnostics"]]
    assert any("fused separately" in text for text in said)

    other = run(
        folder, tmp_path / "out", config("scan.every=2", "scan.last=17", "register.piece=2"), until="fuse"
    )
    assert len(read_tum(tmp_path / "out" / "trajectory.tum").poses) == 3
    assert (tmp_path / "out" / "pieces" / "fused-1.ply").is_file()
    assert not (tmp_path / "out" / "pieces" / "fused-2.ply").exists()
    assert other.report["stages"]["register"]["metrics"]["frames"] == 3


def test_poses_of_a_scan_are_refined(tmp_path: Path) -> None:
    out = tmp_path / "out"
    made = run(SAMPLE, out, config("register.refine=true", "adjust.enabled=false"), until="fuse")
    assert [outcome.stage for outcome in made.stages] == ["register", "fuse"]
    truth = read_scan(SAMPLE).frames[::3]
    for pose, true in zip(read_tum(out / "trajectory.tum").poses, truth, strict=True):
        np.testing.assert_allclose(pose, true.world_from_camera, atol=0.01)


def test_refine_has_no_effect_if_poses_are_adjusted(tmp_path: Path) -> None:
    made = run(SAMPLE, tmp_path / "out", config("register.refine=true"), until="fuse")
    assert [outcome.stage for outcome in made.stages] == ["adjust", "fuse"]
    assert any("register.refine has no effect" in text for text in map(str, made.diagnostics))


def test_a_scan_with_poses_is_registered_only_on_request(tmp_path: Path) -> None:
    plain = run(SAMPLE, tmp_path / "plain", config(), until="fuse")
    assert [outcome.stage for outcome in plain.stages] == ["adjust", "fuse"]
    with pytest.raises(UsageError, match="register does not apply to this scan: its frames have poses"):
        run(SAMPLE, tmp_path / "no", config(), until="register")
    anew = run(SAMPLE, tmp_path / "anew", config("register.enabled=true"), until="register")
    assert [outcome.stage for outcome in anew.stages] == ["register"]


def test_a_scan_without_poses_is_refused_if_registration_is_disabled(unposed: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no poses: .*scan\.poses=FILE"):
        run(unposed, tmp_path / "out", config("register.enabled=false"))


def test_time_stamps_reach_the_trajectory(unposed: Path, tmp_path: Path) -> None:
    """Time stamps of the current scan are written, although no stage key depends on them.

    No stage computes with time stamps. A second run once reused the time stamps of the first run.
    """
    folder = tmp_path / "scan"
    shutil.copytree(unposed, folder)

    def times(start: int) -> list[str]:
        document = json.loads((folder / "scan.json").read_text())
        for i, frame in enumerate(document["frames"]):
            frame["timestamp"] = start + i * 1_000_000_000
        (folder / "scan.json").write_text(json.dumps(document))
        run(folder, tmp_path / "out", config("scan.last=9"), until="register")
        lines = (tmp_path / "out" / "trajectory.tum").read_text().splitlines()
        return [line.split()[0] for line in lines if not line.startswith("#")]

    assert [float(word) for word in times(100_000_000_000)] == [100, 103, 106, 109]
    assert [float(word) for word in times(200_000_000_000)] == [200, 203, 206, 209]
    assert [float(word) for word in times(200_000_000_000)] == [200, 203, 206, 209]
