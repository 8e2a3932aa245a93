"""Command `coverage`: table, JSON, and exit codes for refused input."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Run = Callable[..., Any]
FEW = ("--set", "texture.enabled=false", "--set", "report.enabled=false", "--set", "fuse.voxel_size=0.03")


@pytest.fixture(scope="module")
def out(tiny_scan: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from scanloom.cli.app import run_command

    folder = tmp_path_factory.mktemp("out")
    assert run_command(["run", str(tiny_scan), "-o", str(folder), "--quiet", *FEW]) == 0
    return folder


def test_the_table_and_json_list_the_same_defects(scanloom: Run, out: Path) -> None:
    ran = scanloom("coverage", out)

    assert ran.exit_code == 0
    lines = ran.stdout.splitlines()
    assert lines[0].split()[:2] == ["defect", "m²"]
    assert "next to space that no frame observed" in lines[-2]
    result = json.loads(scanloom("coverage", out, "--json").stdout)
    assert f"median {result['spread_median_m']:.2g} m, 95th percentile" in lines[-1]
    assert len(result["places"]) == len(json.loads((out / "coverage.json").read_text())["places"])
    assert [line.split()[0] for line in lines[1 : len(result["places"]) + 1]] == [
        str(number + 1) for number in range(len(result["places"]))
    ]
    # The ball occludes the wall behind it.
    first = result["places"][0]
    assert first["kind"] in ("hidden", "hole")
    assert 0.75 < first["point_m"][2] < 1.25
    assert [Path(path).name for path in result["output"]] == ["coverage.glb", "coverage.json", "coverage.ply"]


def test_parameters_of_the_stage_apply_to_the_command(scanloom: Run, out: Path) -> None:
    result = json.loads(
        scanloom(
            "coverage", out, "--json", "--set", "coverage.max_defects=1", "--set", "coverage.max_angle=45"
        ).stdout
    )

    assert len(result["places"]) == 1
    assert result["oblique_deg"] == pytest.approx(45)
    assert result["places_omitted"] > 0
    assert (
        "smaller defects are not listed; see --set coverage.max_defects"
        in scanloom("coverage", out, "--set", "coverage.max_defects=1").stdout
    )


def test_a_surface_without_gaps_is_reported(scanloom: Run, out: Path) -> None:
    ran = scanloom("coverage", out, "--set", "coverage.min_area=100")

    assert ran.exit_code == 0
    assert ran.stdout.startswith("No gaps")


@pytest.mark.parametrize(
    ("words", "code", "why"),
    [
        (["missing"], 3, "there is no such folder; give the output folder of a run"),
        ([".", "--scan", "nowhere"], 3, "there is no such folder or file; give a scan folder or recording"),
        (["."], 3, "this folder has no results of a run"),
        ([".", "--set", "coverage.few_frames=0"], 2, "--set coverage.few_frames is 0"),
        ([], 2, "OUT"),
    ],
)
def test_bad_input_is_one_error(
    scanloom: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], code: int, why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = scanloom("coverage", *words)

    assert ran.exit_code == code
    assert why in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1
