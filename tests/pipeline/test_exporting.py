"""The stages `upright` and `export` of a run: upright models and small files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import list_skip_reasons
from scanloom.pipeline.run.run import CACHE_VARIABLE, run
from scanloom.pipeline.steps.upright import UprightSection, estimate_up
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.mesh_files import read_mesh
from tests.made.coloured_sheet import sheet

SCAN = Path(__file__).resolve().parents[2] / "samples" / "rgbd"
QUICK = (
    "scan.every=4",
    "fuse.voxel_size=0.04",
    "report.page=false",
    "report.width=64",
    "report.viewpoints=1",
    "compare.samples=1000",
)


def config(*more: str) -> Config:
    return Config().set([*QUICK, *more])


@pytest.mark.slow
def test_without_a_texture_the_export_is_upright_with_vertex_colours(tmp_path, monkeypatch):
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    run(SCAN, tmp_path, config("texture.enabled=false"))
    plain, light = read_mesh(tmp_path / "simplified.ply"), read_mesh(tmp_path / "simplified.glb")
    np.testing.assert_allclose(light.vertices, plain.vertices, atol=1e-6)
    np.testing.assert_array_equal(light.colors, plain.colors)
    # The world of the sample has z up.
    assert light.up == pytest.approx((0, 0, 1))
    told = json.loads((tmp_path / "report.json").read_text())["stages"]["upright"]["metrics"]
    assert (told["up"], told["up_source"]) == ([0, 0, 1], "surface")

    run(SCAN, tmp_path, config("upright.up=+x", "export.web=true"))
    assert not (tmp_path / "simplified.glb").exists()
    plain = read_mesh(tmp_path / "simplified.ply")
    textured, web = read_mesh(tmp_path / "textured.glb"), read_mesh(tmp_path / "web.glb")
    assert textured.up == web.up == pytest.approx((1, 0, 0))
    np.testing.assert_allclose(textured.vertices.min(axis=0), plain.vertices.min(axis=0), atol=1e-5)
    assert len(web.triangles) == len(textured.triangles)
    assert (tmp_path / "web.glb").stat().st_size < 0.6 * (tmp_path / "textured.glb").stat().st_size

    run(SCAN, tmp_path, config("upright.up=as-is"))
    assert read_mesh(tmp_path / "textured.glb").up is None
    assert not (tmp_path / "web.glb").exists()


def test_export_is_skipped_for_textured_runs_unless_requested():
    scan = read_scan(SCAN)
    assert "export.web=true" in list_skip_reasons(scan, Config())["export"]
    assert "export" not in list_skip_reasons(scan, Config().set(["export.web=true"]))
    assert "export" not in list_skip_reasons(scan, Config().set(["texture.enabled=false"]))


def test_frames_without_poses_give_no_up_direction(tmp_path):
    metrics = estimate_up(tmp_path, sheet(), Scan("made", []), None, UprightSection())
    assert metrics == {"up": None, "up_source": "nothing"}
