"""The optional stage `remesh`: results, metrics, and removal of results when it is disabled."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from coloured_meshes import MESHES

from scanloom.pipeline.config import Config
from scanloom.pipeline.evaluation.measurements import measure_and_draw_levels
from scanloom.pipeline.run.run import CACHE_VARIABLE, run
from scanloom.pipeline.steps.remesh import NormalMeshFiles, RemeshSection, write_normal_mesh
from scanloom.stages.comparing.compare import CompareParams
from scanloom.stages.normal_meshes.normal_mesh import decode
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.progress import ignore_progress
from scanloom.stages.rendering.viewpoints import viewpoints
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.formats.ply import read_ply

pytestmark = pytest.mark.slow

QUICK = (
    "texture.enabled=false",
    "fuse.voxel_size=0.03",
    "report.viewpoints=1",
    "report.page=false",
    "report.width=64",
    "compare.samples=1000",
    "remesh.levels=2",
)
CAMERA = Camera(96, 72, 80.0, 80.0, 47.5, 35.5)
PLAIN = [
    "clean.ply",
    "fused.ply",
    "pictures",
    "refined.ply",
    "report.json",
    "simplified.glb",
    "simplified.ply",
]
OWN = ["levels", "remeshed.ply", "remeshed.snm"]


@pytest.fixture(autouse=True)
def _no_shared_cache(monkeypatch):
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Write four frames of a wavy wall about 1 m away."""
    folder = tmp_path / "scan"
    folder.mkdir()
    v, u = np.mgrid[0:72, 0:96]
    frames = []
    for i in range(4):
        pose = np.eye(4)
        pose[0, 3] = 0.03 * i
        depth = 1 + 0.05 * np.sin((u - 47.5) / 12 + 0.2 * i) * np.cos(v / 15)
        color = np.stack([2 * u, 3 * v, 0 * u + 90], axis=2).astype(np.uint8)
        files = {kind: folder / f"{kind}-{i}.png" for kind in ("color", "depth")}
        cv2.imwrite(str(files["color"]), color)
        cv2.imwrite(str(files["depth"]), np.rint(1000 * depth).astype(np.uint16))
        frames.append(Frame(str(i), CAMERA, files["color"], depth=files["depth"], world_from_camera=pose))
    write_scan_json(folder, frames)
    return folder


def make_quick_config(*assignments: str) -> Config:
    return Config().set([*QUICK, *assignments])


def list_names(out: Path) -> list[str]:
    return sorted(path.name for path in out.iterdir() if path.name != "cache")


def read_up(out) -> list[float]:
    return json.loads((out / "report.json").read_text())["stages"]["upright"]["metrics"]["up"]


def list_computed(result) -> list[str]:
    return [outcome.stage for outcome in result.stages if not outcome.cached]


def test_an_enabled_remesh_stage_writes_levels_and_the_normal_mesh(scan, tmp_path):
    out = tmp_path / "out"
    result = run(scan, out, make_quick_config("remesh.enabled=true"))
    assert list_computed(result) == [
        "adjust",
        "fuse",
        "clean",
        "refine",
        "upright",
        "simplify",
        "remesh",
        "export",
        "report",
    ]
    assert list_names(out) == sorted([*PLAIN, *OWN])
    assert sorted(path.name for path in (out / "levels").iterdir()) == [f"level_{i}.ply" for i in range(3)]
    decoded = decode(out / "remeshed.snm")
    assert decoded.mesh.up == pytest.approx(read_up(out))
    for level, mesh in enumerate(decoded.levels):
        np.testing.assert_array_equal(read_ply(out / "levels" / f"level_{level}.ply").vertices, mesh.vertices)
    assert (out / "remeshed.ply").read_bytes() == (out / "levels" / "level_2.ply").read_bytes()

    told = json.loads((out / "report.json").read_text())
    assert told["stages"]["remesh"]["metrics"]["levels"] == 2
    for level, metrics in enumerate(told["normal_mesh"]["levels"]):
        mesh = decoded.levels[level]
        assert (metrics["level"], metrics["triangles"]) == (level, len(mesh.triangles))
        assert metrics["vertices"] == len(mesh.vertices)
        assert metrics["to_simplified"]["color"]["a_to_b"]["psnr_db"] > 15
    assert told["mesh"]["triangles"] == len(read_ply(out / "simplified.ply").triangles)
    for name in ("level_0", "level_1", "level_2", "distance"):
        assert f"pictures/remeshed-{name}.png" in told["pictures"]
        assert cv2.imread(str(out / "pictures" / f"remeshed-{name}.png")).shape == (48, 64, 3)
    assert list_computed(run(scan, out, make_quick_config("remesh.enabled=true"))) == []


def test_disabling_remesh_removes_its_results_and_keeps_all_others(scan, tmp_path):
    out = tmp_path / "out"
    plain = run(scan, out, make_quick_config())
    assert [outcome.stage for outcome in plain.stages] == [
        "adjust",
        "fuse",
        "clean",
        "refine",
        "upright",
        "simplify",
        "export",
        "report",
    ]
    assert list_names(out) == PLAIN
    assert plain.report["normal_mesh"] is None
    before = sorted(path.name for path in (out / "pictures").iterdir())
    assert list_computed(run(scan, out, make_quick_config("remesh.enabled=true"))) == ["remesh", "report"]
    again = run(scan, out, make_quick_config())
    assert list_computed(again) == []
    assert list_names(out) == PLAIN
    assert sorted(path.name for path in (out / "pictures").iterdir()) == before
    assert list_computed(run(scan, out, make_quick_config("remesh.enabled=true"))) == []
    assert list_names(out) == sorted([*PLAIN, *OWN])


def test_the_key_of_remesh_depends_on_parameters_but_not_threads(scan, tmp_path):
    out = tmp_path / "out"
    run(scan, out, make_quick_config("remesh.enabled=true"))
    finer = run(scan, out, make_quick_config("remesh.enabled=true", "remesh.levels=3"))
    assert list_computed(finer) == ["remesh", "report"]
    assert "levels 2 → 3" in next(one for one in finer.stages if one.stage == "remesh").reason
    run(scan, out, make_quick_config("remesh.enabled=true"))
    assert list_computed(run(scan, out, make_quick_config("remesh.enabled=true", "remesh.threads=1"))) == []
    assert not (out / "levels" / "level_3.ply").exists()


def test_until_remesh_has_no_report(scan, tmp_path):
    result = run(scan, tmp_path / "out", make_quick_config("remesh.enabled=true"), until="remesh")
    assert [outcome.stage for outcome in result.stages] == [
        "adjust",
        "fuse",
        "clean",
        "refine",
        "upright",
        "simplify",
        "remesh",
    ]
    assert result.report["normal_mesh"] is None


def test_finer_levels_are_closer_and_the_picture_shows_the_distance(tmp_path):
    mesh = MESHES["ring"]()
    found = remesh(mesh, levels=2, base_triangles=100)
    view = viewpoints(mesh, 1, width=120)[0]
    metrics, pictures = measure_and_draw_levels(
        tmp_path, mesh, found.levels, view, CompareParams(samples=20_000)
    )
    distances = [one["to_simplified"]["distance"]["symmetric"]["rms_m"] for one in metrics["levels"]]
    assert distances == sorted(distances, reverse=True)
    farthest = metrics["levels"][0]["to_simplified"]["distance"]["a_to_b"]["maximum_m"]
    assert 0 < metrics["full_scale_m"] < farthest
    assert pictures == [*(f"remeshed-level_{level}.png" for level in range(3)), "remeshed-distance.png"]
    painted = cv2.imread(str(tmp_path / "remeshed-distance.png")).astype(int)
    # Both ends of the scale occur: dark blue and yellow.
    assert ((painted[..., 0] > painted[..., 1] + 10) & (painted[..., 2] < 120)).any()
    assert (painted[..., 1] > painted[..., 0] + 60).any()


def test_the_written_normal_mesh_can_be_read(tmp_path):
    mesh = MESHES["holed"]()
    metrics = write_normal_mesh(tmp_path, mesh, RemeshSection(levels=1, base_triangles=100), ignore_progress)
    levels = NormalMeshFiles(tmp_path).load_levels()
    assert [len(level.triangles) for level in levels] == [one["triangles"] for one in metrics["by_level"]]
