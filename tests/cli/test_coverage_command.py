"""coverage: the table a person reads, JSON for programs, and what is refused with which exit code."""

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


def test_a_table_of_places_is_printed_and_json_tells_the_same(scanloom: Run, out: Path) -> None:
    ran = scanloom("coverage", out)

    assert ran.exit_code == 0
    lines = ran.stdout.splitlines()
    assert lines[0].split()[:2] == ["defect", "m²"]
    assert "next to space that no frame observed" in lines[-2]
    told = json.loads(scanloom("coverage", out, "--json").stdout)
    assert f"median {told['spread_median_m']:.2g} m, 95th percentile" in lines[-1]
    assert len(told["places"]) == len(json.loads((out / "coverage.json").read_text())["places"])
    assert [line.split()[0] for line in lines[1 : len(told["places"]) + 1]] == [
        str(number + 1) for number in range(len(told["places"]))
    ]
    # The ball hides the wall behind it.
    first = told["places"][0]
    assert first["kind"] in ("hidden", "hole")
    assert 0.75 < first["point_m"][2] < 1.25
    assert [Path(path).name for path in told["output"]] == ["coverage.glb", "coverage.json", "coverage.ply"]


def test_options_are_those_of_the_stage(scanloom: Run, out: Path) -> None:
    told = json.loads(
        scanloom(
            "coverage", out, "--json", "--set", "coverage.max_defects=1", "--set", "coverage.max_angle=45"
        ).stdout
    )

    assert len(told["places"]) == 1
    assert told["oblique_deg"] == pytest.approx(45)
    assert told["places_omitted"] > 0
    assert (
        "smaller defects are not listed; see --set coverage.max_defects"
        in scanloom("coverage", out, "--set", "coverage.max_defects=1").stdout
    )


def test_where_nothing_is_missing_it_says_so(scanloom: Run, out: Path) -> None:
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
def test_what_cannot_be_done_is_one_sentence(
    scanloom: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], code: int, why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = scanloom("coverage", *words)

    assert ran.exit_code == code
    assert why in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1
