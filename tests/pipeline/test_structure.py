"""A folder of photos without poses passes through the whole pipeline."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import posed_scene
import pytest
from browsers import skip_missing_tool

from scanloom.cli.app import run_command
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import CACHE_VARIABLE, run
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.scans.model.scan import Camera
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.ply import read_ply

CAMERA = Camera(320, 240, 400.0, 400.0, 159.5, 119.5)
QUICK = (
    "report.viewpoints=1",
    "report.page=false",
    "report.width=64",
    "compare.samples=1000",
    "texture.enabled=false",
)


@pytest.fixture(autouse=True)
def _require_pycolmap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    try:
        import pycolmap  # noqa: F401
    except ImportError:
        skip_missing_tool("pycolmap is missing: pip install 'scanloom[sfm]'")


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write eight photos of the made scene, without anything else."""
    folder = tmp_path_factory.mktemp("photos")
    for number in range(8):
        distance = posed_scene.DISTANCE * (0.75, 1.0)[number % 2]
        image, _ = posed_scene.render_view(posed_scene.pose(8.0 * (number - 4), 0, distance), CAMERA)
        cv2.imwrite(str(folder / f"IMG_{number:04d}.png"), image)
    return folder


@pytest.mark.slow
def test_photos_become_a_mesh(photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run(photos, out, Config().set(QUICK))
    names = [stage.stage for stage in result.stages]
    assert names[:3] == ["structure", "depth", "fuse"]
    assert "register" not in names
    metrics = result.report["stages"]["structure"]["metrics"]
    assert metrics["photos"] == 8
    assert not result.report["scan"]["metric"]
    assert any(one.code == "scale.not-metric" for one in result.diagnostics)

    # The model is one of COLMAP, and the photos are found from the scan folder.
    (tmp_path / "workspace").mkdir()
    (tmp_path / "workspace" / "images").symlink_to(photos)
    (tmp_path / "workspace" / "sparse").symlink_to(out / "sparse")
    scan = read_scan(tmp_path / "workspace")
    assert (scan.layout, len(scan.frames)) == ("colmap", 8)

    # The scale follows from the distance of the first and the last camera.
    found = scan.frames[0].world_from_camera[:3, 3] - scan.frames[-1].world_from_camera[:3, 3]
    true = [posed_scene.pose(8.0 * n, 0, d)[:3, 3] for n, d in ((-4, 0.9), (3, 1.2))]
    scale = np.linalg.norm(true[0] - true[1]) / np.linalg.norm(found)
    vertices = read_ply(out / "clean.ply").vertices * scale
    assert len(vertices) > 500
    size = vertices.max(0) - vertices.min(0)
    assert 2 * posed_scene.RADIUS < size.max() < 3 * posed_scene.BOARD

    again = run(photos, out, Config().set([*QUICK, f"scan.scale={scale}"]))
    assert [one.stage for one in again.stages if one.cached] == ["structure"]
    assert again.report["scan"]["metric"]
    assert again.report["scan"]["scale"]["metres_per_unit"] == pytest.approx(scale)
    metric = read_ply(out / "clean.ply").vertices
    np.testing.assert_allclose(metric.max(0) - metric.min(0), size, rtol=0.1)


@pytest.mark.slow
def test_the_stage_runs_alone_and_explains_itself(photos: Path, tmp_path: Path, capsys) -> None:
    code = run_command(["run", str(photos), "-o", str(tmp_path / "out"), "--until", "structure"])
    assert code == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert list(report["stages"]) == ["structure"]
    assert "poses of 8 photos" in "".join(capsys.readouterr())
    with pytest.raises(
        UsageError, match="register does not apply to this scan: structure estimates the poses"
    ):
        run(photos, tmp_path / "no", until="register")


def test_unrelated_photos_end_with_exit_code_3(tmp_path: Path, capsys) -> None:
    random = np.random.default_rng(1)
    (tmp_path / "scan").mkdir()
    for number in range(3):
        cv2.imwrite(str(tmp_path / "scan" / f"{number}.png"), random.integers(0, 256, (60, 80, 3), np.uint8))
    code = run_command(["run", str(tmp_path / "scan"), "-o", str(tmp_path / "out")])
    assert code == 3
    said = " ".join("".join(capsys.readouterr()).split())
    assert "no two of the 3 photos have enough features in common" in said
    with pytest.raises(InputError):
        run(tmp_path / "scan", tmp_path / "out")


@pytest.mark.slow
def test_a_video_becomes_cameras_and_depth(photos: Path, tmp_path: Path) -> None:
    writer = cv2.VideoWriter(
        str(tmp_path / "walk.avi"), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 10, (320, 240)
    )
    for file in sorted(photos.iterdir()):
        writer.write(cv2.imread(str(file)))
    writer.release()
    result = run(tmp_path / "walk.avi", tmp_path / "out", Config().set(QUICK), until="fuse")
    assert [stage.stage for stage in result.stages] == ["structure", "depth", "fuse"]
    assert result.report["stages"]["structure"]["metrics"]["photos"] == 8
    assert sorted(path.name for path in (tmp_path / "out" / "frames").iterdir()) == [
        f"{number:06d}.jpg" for number in range(8)
    ]
    (tmp_path / "workspace").mkdir()
    for name, target in (("images", "frames"), ("sparse", "sparse")):
        (tmp_path / "workspace" / name).symlink_to(tmp_path / "out" / target)
    assert len(read_scan(tmp_path / "workspace").frames) == 8
    assert len(read_ply(tmp_path / "out" / "fused.ply").vertices) > 500
    moved = tmp_path / "moved" / "walk.avi"
    moved.parent.mkdir()
    (tmp_path / "walk.avi").rename(moved)
    again = run(moved, tmp_path / "out", Config().set(QUICK), until="fuse")
    assert all(one.cached for one in again.stages)


@pytest.mark.slow
def test_photos_without_poses_join_those_with_poses(photos: Path, tmp_path: Path) -> None:
    """The file of poses lists six of eight photos."""
    folder = tmp_path / "scan"
    (folder / "images").mkdir(parents=True)
    listed = []
    for number, file in enumerate(sorted(photos.iterdir())):
        shutil.copy(file, folder / "images")
        pose = posed_scene.pose(8.0 * (number - 4), 0, posed_scene.DISTANCE * (0.75, 1.0)[number % 2])
        opengl = (pose @ np.diag((1.0, -1, -1, 1))).tolist()
        if number not in (2, 5):
            listed.append({"file_path": f"images/{file.name}", "transform_matrix": opengl})
    known = {"w": 320, "h": 240, "fl_x": 400, "fl_y": 400, "cx": 160, "cy": 120}
    (folder / "transforms.json").write_text(json.dumps({**known, "frames": listed}))
    without = run(folder, tmp_path / "without", Config().set(QUICK), until="depth")
    assert [stage.stage for stage in without.stages] == ["depth"]
    assert without.report["stages"]["depth"]["metrics"]["frames_used"] == 6

    changes = [*QUICK, "scan.keep_unposed=true", "scan.scale=2"]
    result = run(folder, tmp_path / "out", Config().set(changes), until="depth")
    assert [stage.stage for stage in result.stages] == ["structure", "depth"]
    assert result.report["stages"]["structure"]["metrics"]["photos"] == 8
    assert result.report["stages"]["depth"]["metrics"]["frames_used"] == 8
    assert result.report["scan"]["metric"]
    frames = read_scan(next((result.cache / "depth").iterdir()), complete=False).frames
    for number in (1, 2, 5):
        true = posed_scene.pose(8.0 * (number - 4), 0, posed_scene.DISTANCE * (0.75, 1.0)[number % 2])
        found = frames[number].world_from_camera
        np.testing.assert_allclose(found[:3, 3], 2 * true[:3, 3], atol=0.03)
