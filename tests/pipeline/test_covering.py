"""The optional stage `coverage` during and after a run: files, page, and errors."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from page_content import read_page_content

from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.resume import continue_run
from scanloom.pipeline.run.run import CACHE_VARIABLE, run
from scanloom.pipeline.run.run_request import RunRequest, make_paths_absolute
from scanloom.pipeline.steps.coverage import VERTEX_VALUES
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values
from scanloom.stages.surface.mesh_files import read_mesh

CAMERA = Camera(96, 72, 80.0, 80.0, 47.5, 35.5)
QUICK = (
    "texture.enabled=false",
    "fuse.voxel_size=0.015",
    "report.viewpoints=1",
    "report.width=64",
    "report.photos=0",
    "compare.samples=1000",
)
OWN = ["coverage.glb", "coverage.json", "coverage.ply"]


@pytest.fixture(autouse=True)
def _no_shared_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)


def make_scan(folder: Path) -> Path:
    """Write four frames of a wall 1 m away with a pane of black glass of 20 × 15 cm."""
    folder.mkdir()
    v, u = np.mgrid[0:72, 0:96]
    frames = []
    for i in range(4):
        pose = np.eye(4)
        pose[0, 3] = 0.04 * i
        x, y = (u - CAMERA.cx) / CAMERA.fx + pose[0, 3], (v - CAMERA.cy) / CAMERA.fy
        depth = np.where((np.abs(x - 0.1) < 0.1) & (np.abs(y) < 0.075), 0, 1000).astype(np.uint16)
        files = {kind: folder / f"{kind}-{i}.png" for kind in ("color", "depth")}
        cv2.imwrite(str(files["color"]), np.stack([2 * u, 3 * v, 0 * u + 90], axis=2).astype(np.uint8))
        cv2.imwrite(str(files["depth"]), depth)
        frames.append(Frame(str(i), CAMERA, files["color"], depth=files["depth"], world_from_camera=pose))
    write_scan_json(folder, frames)
    return folder


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a folder with a scan and the results of a run without the stage in out/."""
    folder = tmp_path_factory.mktemp("covering")
    run(make_scan(folder / "scan"), folder / "out", Config().set(QUICK))
    return folder


@pytest.fixture
def here(ran: Path, tmp_path: Path) -> Path:
    """Copy the folder; the record of the run still refers to the original scan."""
    shutil.copytree(ran, tmp_path / "all", symlinks=True)
    return tmp_path / "all"


def list_names(out: Path) -> list[str]:
    return sorted(path.name for path in out.iterdir())


def list_computed(result: Any) -> list[str]:
    return [outcome.stage for outcome in result.stages if not outcome.cached]


def test_after_a_run_only_the_coverage_stage_is_computed(here: Path) -> None:
    out = here / "out"
    before = list_names(out)
    result = continue_run(out, "coverage", {})

    assert list_computed(result) == ["coverage"]
    assert list_names(out) == sorted([*before, *OWN])
    told = json.loads((out / "coverage.json").read_text())
    first = told["places"][0]
    assert first["kind"] == "hole"
    np.testing.assert_allclose(first["point_m"], (0.1, 0, 1), atol=0.06)
    assert first["area_m2"] == pytest.approx(0.2 * 0.15, rel=0.6)
    assert {one["why"] for one in first["nearest_frames"]} == {"no depth there"}
    report = json.loads((out / "report.json").read_text())
    assert report["stages"]["coverage"]["metrics"]["places"] == len(told["places"])
    assert {*report["placed"]["coverage"]} == {*OWN}
    assert list_computed(continue_run(out, "coverage", {})) == []


def test_the_mesh_has_coverage_values_per_vertex(here: Path) -> None:
    out = here / "out"
    continue_run(out, "coverage", {})
    mesh, clean = read_ply(out / "coverage.ply"), read_ply(out / "refined.ply")
    values = {name: read_vertex_values(out / "coverage.ply", name) for name in VERTEX_VALUES}
    assert set(values) == {"frames", "angle", "mean_angle", "pixel", "spread"}

    count = len(clean.vertices)
    np.testing.assert_array_equal(mesh.vertices[:count], clean.vertices)
    assert values["frames"].max() == 4
    assert (values["frames"][count:] == 0).all()
    middle = np.abs(clean.vertices[:, 0] + 0.2) < 0.05
    assert values["angle"][:count][middle].max() < 30
    assert values["pixel"][:count][middle] == pytest.approx(1 / 80, rel=0.15)
    assert (values["mean_angle"] >= values["angle"] - 1e-3).all()
    # Depth is exact; the surface is flat within the limits of 1.5 cm voxels.
    assert values["spread"][:count][middle].max() < 0.001
    told = json.loads((out / "coverage.json").read_text())
    assert 0 <= told["spread_median_m"] <= told["spread_95_m"] < 0.02
    model = read_mesh(out / "coverage.glb")
    assert len(model.triangles) == len(mesh.triangles)


def test_the_page_shows_coverage_and_suggested_viewpoints(here: Path) -> None:
    out = here / "out"
    continue_run(out, "coverage", {})
    content = read_page_content((out / "report.html").read_bytes())

    model = next(one for one in content["models"] if one["name"] == "coverage")
    assert "red hole in the surface" in model["note"]
    (look,) = (one for one in content["models"] if one["name"] == "spread")
    scale = look["scale"]
    assert (look["file"], scale["unit"]) == (model["file"], "mm")
    assert sum(scale["shares"]) == pytest.approx(1, abs=1e-3)
    # Unmeasured surface, including caps of holes, is below the start of the scale.
    assert scale["shares"][0] > 0
    assert scale["marks"][0] == 0 > scale["low"]
    table = content["tables"][0]
    assert table["title"] == "Gaps to capture again"
    told = json.loads((out / "coverage.json").read_text())["places"]
    assert len(table["rows"]) == len(table["places"]) == len(told)
    place = table["places"][0]
    assert place["away"] == pytest.approx(np.linalg.norm(np.subtract(place["eye"], place["target"])))
    assert place["away"] == pytest.approx(
        np.linalg.norm(np.subtract(told[0]["viewpoint_m"], told[0]["point_m"]))
    )
    assert table["rows"][0][0] == "hole in the surface"


def test_a_damaged_coverage_list_is_refused_by_the_page(here: Path) -> None:
    from scanloom.pipeline.report.run_page import make_run_page

    out = here / "out"
    continue_run(out, "coverage", {})
    for wrong in ('{"places": 3}', '{"places": [{"why": "x"}]}', "[]"):
        (out / "coverage.json").write_text(wrong)
        with pytest.raises(InputError, match="not written by a run, or is damaged"):
            make_run_page(out, 5_000_000)


def test_other_parameters_recompute_and_a_run_without_coverage_removes_it(here: Path, ran: Path) -> None:
    out = here / "out"
    continue_run(out, "coverage", {})
    page = (out / "report.html").read_bytes()
    fewer = continue_run(out, "coverage", {"max_defects": 1})

    assert list_computed(fewer) == ["coverage"]
    assert len(json.loads((out / "coverage.json").read_text())["places"]) == 1
    assert (out / "report.html").read_bytes() != page
    plain = run(ran / "scan", out, Config().set(QUICK))
    assert list_computed(plain) == []
    assert not {*OWN} & {*list_names(out)}
    assert b"Gaps to capture again" not in (out / "report.html").read_bytes()


def test_a_moved_scan_must_be_named_and_then_hits_the_cache(here: Path, tmp_path: Path) -> None:
    made = make_scan(tmp_path / "first")
    run(made, here / "other", Config().set(QUICK), until="refine")
    made.rename(tmp_path / "second")
    with pytest.raises(InputError, match="does not exist any more; give its new location with --scan"):
        continue_run(here / "other", "coverage", {})
    found = continue_run(here / "other", "coverage", {}, scan=tmp_path / "second")

    # The first run had ended before upright.
    assert list_computed(found) == ["upright", "simplify", "export", "coverage"]


def test_folders_without_a_run_are_refused(here: Path, tmp_path: Path) -> None:
    for path, why in ((tmp_path / "none", "no such folder"), (here / "scan" / "scan.json", "this is a file")):
        with pytest.raises(InputError, match=why):
            continue_run(path, "coverage", {})
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="this folder has no results of a run"):
        continue_run(tmp_path / "empty", "coverage", {})
    (here / "out" / "refined.ply").unlink()
    with pytest.raises(InputError, match=r"refined\.ply is missing"):
        continue_run(here / "out", "coverage", {})
    shutil.rmtree(here / "out" / "cache")
    with pytest.raises(InputError, match="has no record of this run; give the cache of the run"):
        continue_run(here / "out", "coverage", {})


def test_a_run_that_was_not_finished_has_no_mesh(here: Path, ran: Path) -> None:
    run(ran / "scan", here / "short", Config().set(QUICK), until="fuse")
    with pytest.raises(InputError, match=r"refined\.ply is missing, because the run ended before it"):
        continue_run(here / "short", "coverage", {})


def test_wrong_parameters_are_refused_before_any_work(here: Path) -> None:
    with pytest.raises(UsageError, match="max_angle"):
        continue_run(here / "out", "coverage", {"max_angle": 100.0})


def test_the_record_stores_parameters_with_absolute_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("poses.txt", "auto", "apriltag-36h11"):
        (tmp_path / name).write_text("")
    config = Config().set(("scan.poses=poses.txt", "scan.tag_family=apriltag-36h11", "coverage.max_angle=60"))
    asked = RunRequest(tmp_path / "scan", make_paths_absolute(config), "report")
    again = RunRequest.from_record(json.loads(json.dumps(asked.to_json())))

    assert again == asked
    assert again.config.scan.poses == str(tmp_path / "poses.txt")
    # The tag family equals a file name but is not a path.
    assert again.config.scan.tag_family == "apriltag-36h11"
    assert again.config.depth.matcher == "auto"
    assert again.config.coverage.max_angle == 60
    for wrong in (
        None,
        {},
        {"scan": 3, "config": "", "until": ""},
        {**asked.to_json(), "config": "[nonsense]"},
    ):
        assert RunRequest.from_record(wrong) is None


def test_results_contain_no_absolute_paths(ran: Path) -> None:
    record = Cache(ran / "out" / "cache").read_latest_run(ran / "out")

    assert record["asked"]["scan"] == str(ran / "scan")
    for name in ("report.json", "report.html"):
        assert str(ran) not in (ran / "out" / name).read_text()
