"""A run whose meshes are too large for memory: report, page, and levels of detail."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chunked_sample import use_small_chunks, write_partial_sample
from page_content import read_page_content

from scanloom.pipeline.config import Config
from scanloom.pipeline.evaluation.measurements import SIGNED_SAMPLES
from scanloom.pipeline.run.dry_run import predict_run
from scanloom.pipeline.run.run import RunResult, run
from scanloom.stages import coverage, lod, read_scan
from scanloom.stages.comparing.certify import certify
from scanloom.stages.comparing.compare import compare
from scanloom.stages.comparing.deviations import deviations
from scanloom.stages.surface import chunked_mesh
from scanloom.stages.surface.chunked_ply import make_table_path
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values

QUICK = (
    *("adjust.enabled=false", "texture.enabled=false", "export.web=false", "fuse.voxel_size=0.015"),
    *("report.viewpoints=2", "report.width=128", "report.photos=0", "compare.samples=2000"),
    *("lod.cell_triangles=500", "lod.root_triangles=100"),
)
BOUND = "simplify.max_shape=0.009"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, RunResult, list[str]]:
    """Run on a few frames of the sample; return scan, output folder, result and warnings."""
    folder = tmp_path_factory.mktemp("large")
    scan, out = write_partial_sample(folder / "scan", list(range(0, 24, 6))), folder / "out"
    with use_small_chunks():
        return (scan, out, *run_scan(scan, out, BOUND, "lod.enabled=true", "coverage.enabled=true"))


def run_scan(scan: Path, out: Path, *more: str, until: str | None = None) -> tuple[RunResult, list[str]]:
    config = Config().set([*QUICK, *more])
    result = run(scan, out, config, until=until, cache_dir=f"{out}-cache")
    return result, [str(one) for one in result.diagnostics]


def get_metrics(result: RunResult, stage: str) -> dict[str, Any]:
    metrics: dict[str, Any] = result.report["stages"][stage]["metrics"]
    return metrics


@pytest.mark.slow
def test_the_report_equals_the_report_of_in_memory_meshes(made: Any) -> None:
    _, out, result, _ = made
    light = read_ply(out / "simplified.ply")
    assert get_metrics(result, "simplify")["parts"] > 5
    told = result.report["mesh"]
    for name, samples in (("fused", 2000), ("refined", 500)):
        expected = compare(read_ply(out / f"{name}.ply"), light, samples=samples).to_dict()
        for kind in ("distance", "color"):
            for way, values in expected[kind].items():
                assert told[f"to_{name}"][kind][way] == pytest.approx(values, rel=1e-5, abs=1e-9)
    expected = deviations(read_ply(out / "refined.ply"), light, signed_samples=SIGNED_SAMPLES).to_dict()
    for name in ("rms_m", "mean_m", "lowest_m", "highest_m", "absolute_percentiles_m"):
        assert result.report["deviation"][name] == pytest.approx(expected[name], rel=1e-5, abs=1e-9)
    drawn = [name for name in result.report["pictures"] if "triangles" not in name]
    assert len(drawn) == 6
    assert all((out / name).is_file() for name in result.report["pictures"])


def test_the_page_shows_a_subsample_of_large_meshes(made: Any) -> None:
    _, out, _, said = made
    page = read_page_content((out / "report.html").read_bytes())
    models = {one["name"]: one for one in page["models"]}
    assert list(models) == ["result", "refined mesh", "coverage", "deviation"]
    for name, file in (("refined mesh", "refined"), ("coverage", "coverage")):
        count = len(read_ply(out / f"{file}.ply").triangles)
        assert models[name]["triangles"] < count
        assert "clustered in cells of" in models[name]["note"]
        assert f"reduced from {count:,} for this page" in models[name]["note"]
    assert not any("page" in text for text in (*said, *page["warnings"]))


def test_coverage_equals_that_of_an_in_memory_mesh(made: Any) -> None:
    scan, out, result, said = made
    expected = coverage(read_ply(out / "refined.ply"), read_scan(scan))
    told = json.loads((out / "coverage.json").read_text())
    assert get_metrics(result, "coverage")["places"] == len(told["places"]) == len(expected.defects) > 0
    for place, one in zip(told["places"], expected.to_dict()["places"], strict=True):
        for name in ("kind", "point_m", "viewpoint_m", "frames_in_view"):
            assert place[name] == one[name]
        assert place["area_m2"] == pytest.approx(one["area_m2"], rel=1e-6)
    painted = read_ply(out / "coverage.ply")
    np.testing.assert_array_equal(painted.vertices, expected.painted_mesh.vertices)
    np.testing.assert_array_equal(painted.triangles, expected.painted_mesh.triangles)
    np.testing.assert_allclose(painted.colors.astype(int), expected.painted_mesh.colors.astype(int), atol=1)
    count = len(expected.vertex_kinds)
    for name, value in (
        ("frames", expected.vertex_evidence.frame_counts),
        ("spread", expected.vertex_evidence.rms_height),
    ):
        values = read_vertex_values(out / "coverage.ply", name)
        np.testing.assert_allclose(values[:count], value, rtol=1e-4, atol=1e-7)
        assert not values[count:].any()
    assert not (out / "coverage.glb").exists()
    assert sum("coverage.glb is not written:" in text for text in said) == 1
    table = read_page_content((out / "report.html").read_bytes())["tables"][0]
    assert table["title"] == "Gaps to capture again"
    assert len(table["rows"]) == len(told["places"])


def test_levels_start_from_the_simplified_mesh_with_bounds_to_the_clean_mesh(made: Any) -> None:
    scan, out, result, said = made
    told, proven = get_metrics(result, "lod"), get_metrics(result, "simplify")["details"]
    clean, hierarchy = read_ply(out / "refined.ply"), lod.read_slod(out / "lod.slod")
    assert told["base_shape_bound_m"] == proven["shape_bound_m"] <= 0.009
    assert hierarchy.base_color_bound == proven["color_bound_levels"]
    assert told["base_triangles"] == get_metrics(result, "simplify")["triangles"]
    assert told["input_triangles"] == len(clean.triangles)
    assert sum("built from the simplified mesh, which is proven to be within" in text for text in said) == 1
    # A separate proof: the bound of the coarsest level also holds for the clean mesh, which it was not built
    # from.
    cut = hierarchy.cut(triangles=1)
    assert certify(cut.mesh, clean, max_shape=cut.shape_bound_m).within_limits
    # A coarser finest level adds its own error.
    with use_small_chunks():
        lighter, _ = run_scan(scan, out, BOUND, "lod.enabled=true", "lod.base_error=0.015", until="lod")
        assert [one.stage for one in lighter.stages if not one.cached] == ["lod"]
        told = get_metrics(lighter, "lod")
        assert told["base_triangles"] < get_metrics(result, "lod")["base_triangles"]
        assert proven["shape_bound_m"] < told["base_shape_bound_m"] <= 0.015


def test_levels_without_proven_bounds_are_reported(made: Any, tmp_path: Path) -> None:
    scan, _, _, _ = made
    out = tmp_path / "out"
    with use_small_chunks():
        result, said = run_scan(scan, out, "simplify.ratio=0.2", "lod.enabled=true", until="lod")
        told = get_metrics(result, "lod")
        assert told["base_shape_bound_m"] == 0
        assert told["input_triangles"] == get_metrics(result, "simplify")["triangles"]
        assert sum("whose distance from the refined mesh is not proven" in text for text in said) == 1
        assert "is not proven" in str(lod.read_slod(out / "lod.slod").diagnostics[-1])
        other = Config().set([*QUICK, "simplify.ratio=0.1", "lod.enabled=true"])
        foreseen = predict_run(scan, out, other, until="lod", cache_dir=f"{out}-cache").stages
        assert [one.stage for one in foreseen if not one.cached] == ["simplify", "lod"]


def test_refining_a_chunked_mesh_equals_in_memory_refinement(made: Any, tmp_path: Path) -> None:
    scan, out, result, said = made
    with use_small_chunks(max_in_memory=5_000_000):
        at_once, _ = run_scan(scan, tmp_path / "out", until="refine")
    chunked, whole = out / "refined.ply", tmp_path / "out" / "refined.ply"
    assert chunked.read_bytes() == whole.read_bytes()
    assert (out / "clean.ply").read_bytes() == (tmp_path / "out" / "clean.ply").read_bytes()
    assert chunked.read_bytes() != (out / "clean.ply").read_bytes()
    assert get_metrics(result, "refine") == get_metrics(at_once, "refine")
    assert get_metrics(result, "refine")["why"] == ""
    # Flaps, skirts and holes extend over chunks.
    assert get_metrics(result, "refine")["removed_triangles"] > 0
    assert get_metrics(result, "refine")["filled_holes"] > 0
    folders = [next((Path(f"{one}-cache") / "refine").iterdir()) for one in (out, tmp_path / "out")]
    assert [make_table_path(one / "refined.ply").exists() for one in folders] == [True, False]
    assert 0 < np.median(read_vertex_values(chunked, "deviation")) < 0.01
    filled = read_vertex_values(chunked, "filled")
    assert filled is not None
    assert set(filled.tolist()) <= {0.0, 1.0}
    assert not any("refined.ply" in text for text in said)


def test_a_mesh_in_memory_is_reported_in_chunks(
    made: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunked_mesh, "_MAX_SINGLE_CHUNK_TRIANGLES", 3_000)
    result, _ = run_scan(made[0], tmp_path / "out")
    assert get_metrics(result, "refine")["filled_holes"] > 0
    assert len(result.report["pictures"]) >= 6
    assert "pictures/refined-filled.png" not in result.report["pictures"]


def test_without_enough_memory_refinement_is_skipped_and_reported(made: Any, tmp_path: Path) -> None:
    scan, out = made[0], tmp_path / "out"
    little = "refine.memory=1"

    def refine_again(*settings: str) -> tuple[dict[str, Any], list[str], bool]:
        result, said = run_scan(scan, out, *settings, until="refine")
        stage = next(one for one in result.stages if one.stage == "refine")
        return (
            get_metrics(result, "refine"),
            [text for text in said if "is not refined" in text],
            stage.cached,
        )

    with use_small_chunks():
        kept, said, _ = refine_again(little)
        assert (out / "refined.ply").read_bytes() == (out / "clean.ply").read_bytes()
        assert "more memory than refine.memory allows" in kept["why"]
        assert len(said) == 1
        assert re.search(r"its [\d,]+ triangles need .* GB .* limit of 0\.001 GB .*refine\.memory", said[0])
        # Refined meshes have a different cache key; the limit itself is not in the key.
        refined, said, cached = refine_again()
        assert (refined["why"], said, cached) == ("", [], False)
        assert refine_again("refine.memory=7000")[2]
        assert refine_again(little)[2]
