"""A folder of posed photos passes through the whole pipeline."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import posed_scene
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from scanloom.cli.app import app
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import CACHE_VARIABLE, run
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.views_depth import views_depth
from scanloom.stages.surface.formats.ply import read_ply

pytestmark = pytest.mark.slow

QUICK = ("report.viewpoints=1", "report.page=false", "report.width=64", "compare.samples=1000")


@pytest.fixture(autouse=True)
def _no_shared_cache(monkeypatch):
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return posed_scene.write_posed_views(tmp_path / "scan")


@pytest.mark.slow
def test_views_become_a_mesh_at_the_true_surface(folder: Path, tmp_path: Path) -> None:
    config = Config().set(QUICK)
    result = run(folder, tmp_path / "out", config)

    assert [stage.stage for stage in result.stages] == [
        "depth",
        "fuse",
        "clean",
        "refine",
        "upright",
        "simplify",
        "texture",
        "report",
    ]
    assert result.report["stages"]["depth"]["metrics"]["frames_used"] == 7
    vertices = read_ply(tmp_path / "out" / "clean.ply").vertices
    to_ball = np.abs(np.linalg.norm(vertices, axis=1) - posed_scene.RADIUS)
    to_board = np.abs(vertices[:, 2] - posed_scene.BOARD_Z)
    assert np.median(np.minimum(to_ball, to_board)) < 0.004
    assert np.mean(np.minimum(to_ball, to_board) > 0.03) < 0.03
    # Both are reconstructed: the front of the sphere and the board behind it.
    assert np.mean(vertices[:, 2] < 0) > 0.05
    assert np.mean(to_board < 0.02) > 0.2
    again = run(folder, tmp_path / "out", config)
    assert all(stage.cached for stage in again.stages)


def write_nerfstudio(folder: Path, scan: Scan) -> None:
    """Write views in nerfstudio's convention: y up, z backwards, pixel coordinates from the image corner."""
    camera = posed_scene.CAMERA
    frames = []
    for frame in scan.frames:
        turned = frame.world_from_camera.copy()
        turned[:3, 1:3] *= -1
        frames.append({"file_path": f"images/{frame.name}.png", "transform_matrix": turned.tolist()})
    (folder / "transforms.json").write_text(
        json.dumps(
            {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
            | {"cx": camera.cx + 0.5, "cy": camera.cy + 0.5, "frames": frames}
        )
    )


def write_colmap(folder: Path, scan: Scan) -> None:
    """Write views in COLMAP's convention: world-to-camera, pixel coordinates from the image corner."""
    camera = posed_scene.CAMERA
    values = f"{camera.fx} {camera.fy} {camera.cx + 0.5} {camera.cy + 0.5}"
    (folder / "cameras.txt").write_text(f"1 PINHOLE {camera.width} {camera.height} {values}\n")
    lines = []
    for number, frame in enumerate(scan.frames):
        camera_from_world = invert_pose(frame.world_from_camera)
        x, y, z, w = Rotation.from_matrix(camera_from_world[:3, :3]).as_quat()
        numbers = " ".join(repr(float(one)) for one in (w, x, y, z, *camera_from_world[:3, 3]))
        lines.append(f"{number} {numbers} 1 {frame.name}.png\n\n")
    (folder / "images.txt").write_text("".join(lines))


@pytest.fixture(scope="module")
def in_memory() -> tuple[Scan, list[np.ndarray], list[np.ndarray]]:
    """Compute the depth of the made scene once; return scan, true depth and estimated depth."""
    scan, truth = posed_scene.make_posed_scan()
    return scan, truth, [result.depth for _, result in views_depth(scan)]


@pytest.mark.parametrize("write", [write_nerfstudio, write_colmap])
def test_views_of_other_layouts_have_the_same_depth(
    in_memory: tuple[Scan, list[np.ndarray], list[np.ndarray]], tmp_path: Path, write: Callable[..., None]
) -> None:
    scan, truth, owns = in_memory
    (tmp_path / "images").mkdir()
    for frame in scan.frames:
        cv2.imwrite(str(tmp_path / "images" / f"{frame.name}.png"), frame.color)
    write(tmp_path, scan)
    read = read_scan(tmp_path)
    assert (read.layout, read.is_views) == (write.__name__, True)

    results = [result for _, result in views_depth(read)]

    for result, own, true in zip(results, owns, truth, strict=True):
        # Rounding of poses moves a few depths across the agreement threshold.
        both = (result.depth > 0) & (own > 0)
        assert np.mean((result.depth > 0) == (own > 0)) > 0.999
        assert np.mean(np.abs(result.depth - own)[both] < 1e-3) > 0.999
        assert np.median(np.abs(result.depth - true)[both & (true > 0)]) < 0.004


def test_commands_accept_views(folder: Path, tmp_path: Path) -> None:
    runner = CliRunner()
    found = json.loads(runner.invoke(app(), ["inspect", str(folder), "--json"]).stdout)
    assert (found["kind"], found["layout"], found["depth_scale_per_m"]) == ("views", "middlebury-mview", None)
    assert found["diagnostics"] == []

    refused = runner.invoke(app(), ["fuse", str(folder), str(tmp_path / "fused.ply")])
    assert refused.exit_code != 0
    assert "single views without depth" in str(refused.exception) + refused.output

    done = runner.invoke(app(), ["depth", str(folder), str(tmp_path / "depth"), "--json"])
    assert done.exit_code == 0, done.output
    depth = read_scan(tmp_path / "depth")
    assert len(depth.frames) == 7
    assert not depth.is_views
    np.testing.assert_allclose(
        depth.frames[2].world_from_camera, read_scan(folder).frames[2].world_from_camera, atol=1e-9
    )
