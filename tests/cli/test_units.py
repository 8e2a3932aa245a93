"""Lengths of a scan without metric scale are printed in units, not in metres."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

Run = Callable[..., Any]


@pytest.fixture
def unit_scan(tiny_scan: Path, tmp_path: Path) -> Path:
    """Copy the tiny scan, with lengths in an unknown unit."""
    folder = Path(shutil.copytree(tiny_scan, tmp_path / "scan"))
    file = folder / "scan.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"metric": False, "up": [0, -1, 0]}))
    return folder


def test_inspect_prints_units_and_the_options_for_a_scale(scanloom: Run, unit_scan: Path) -> None:
    text = scanloom("inspect", unit_scan).stdout
    assert "scale     unknown: lengths are in units" in text
    assert "up        0 -1 0, from scan.json" in text
    measured = ("path", "depth", "poses", "extent", "looks", "fusion")
    lengths = [line for line in text.splitlines() if line.split()[0] in measured]
    assert {line.split()[0] for line in lengths} >= {"depth", "extent", "looks", "fusion"}
    assert all(" units" in line for line in lengths)
    assert not any(
        line.endswith(" m") or " m " in line or " m;" in line or " m," in line or "mm" in line
        for line in lengths
    )
    given = ("scale=METRES_PER_UNIT, ", "known_distance='MEASURED METRES' or ", "tag_size=METRES")
    assert "".join(f"--set scan.{one}" for one in given) in text
    metrics = scanloom("inspect", unit_scan, "--json").json
    assert (metrics["metric"], metrics["scale"]) == (False, None)
    assert (metrics["up"], metrics["up_source"]) == ([0, -1, 0], "scan.json")


def test_inspect_prints_a_given_scale(scanloom: Run, unit_scan: Path) -> None:
    text = scanloom("inspect", unit_scan, "--set", "scan.known_distance=2 0.5").stdout
    assert "scale     0.25 m per unit, a known distance" in text
    assert " units" not in text
    assert "no metric scale" not in text
    metrics = scanloom("inspect", unit_scan, "--set", "scan.scale=0.25", "--json").json
    plain = scanloom("inspect", unit_scan, "--json").json
    assert metrics["metric"]
    assert metrics["scale"]["metres_per_unit"] == 0.25
    assert metrics["path"]["length_m"] == pytest.approx(0.25 * plain["path"]["length_m"])
    assert metrics["depth"]["median_m"] == pytest.approx(0.25 * plain["depth"]["median_m"])


@pytest.mark.slow
def test_run_prints_units_and_after_scaling_metres(scanloom: Run, unit_scan: Path, tmp_path: Path) -> None:
    def run_to_simplify(*more: object) -> tuple[str, list[str], dict[str, Any]]:
        ran = scanloom("run", unit_scan, "-o", tmp_path / "out", "--until", "simplify", *more)
        report = json.loads((tmp_path / "out" / "report.json").read_text())
        return ran.stderr, [one for one in ran.stderr.splitlines() if one.startswith("fuse ")], report

    stderr, (fused,), report = run_to_simplify()
    assert "warning: this scan has no metric scale" in stderr
    assert " units, truncation " in fused
    assert " m," not in fused
    assert report["scan"]["metric"] is False
    assert any(one["code"] == "scale.not-metric" for one in report["scan"]["diagnostics"])
    before = report["stages"]["fuse"]["metrics"]["voxel_size_m"]

    stderr, (fused,), report = run_to_simplify("--set", "scan.scale=0.5")
    assert "warning" not in stderr
    assert " m, truncation " in fused
    assert (report["scan"]["metric"], report["scan"]["scale"]["metres_per_unit"]) == (True, 0.5)
    assert report["stages"]["fuse"]["metrics"]["voxel_size_m"] == pytest.approx(before / 2, rel=0.1)
    # A scale of 1 m per unit does not change results.
    _, _, report = run_to_simplify("--set", "scan.scale=1")
    assert [one["cached"] for name, one in report["stages"].items() if name != "upright"] == [True] * 5


def test_a_malformed_scale_is_reported_as_typed(scanloom: Run, unit_scan: Path) -> None:
    ran = scanloom("inspect", unit_scan, "--set", "scan.known_distance=far")
    assert ran.exit_code == 2
    assert "--set scan.known_distance is 'far'" in ran.stderr


def test_render_scales_the_cameras_of_a_scan(
    scanloom: Run, ball: Path, unit_scan: Path, tmp_path: Path
) -> None:
    def render_view(*words: object) -> np.ndarray[Any, Any]:
        assert (
            scanloom("render", ball, tmp_path / "p.png", "--width", 48, "--viewpoint", 2, *words).exit_code
            == 0
        )
        return cv2.imread(str(tmp_path / "p.png"))

    near, far = (render_view("--scan", unit_scan, "--set", f"scan.scale={factor}") for factor in (1, 40))
    assert np.abs(near.astype(int) - far).max() > 30
    assert scanloom("render", ball, tmp_path / "p.png", "--set", "scan.scale=2").exit_code == 2
