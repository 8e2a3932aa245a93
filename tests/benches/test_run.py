"""The bench of whole runs measures each stage and compares it with an earlier version."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import run as bench
from small_scans import write_small_scan

from scanloom.stages.scans.model.threads import THREADS_VARIABLE


def test_sizes_of_files_in_folders_are_summed(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    for name, size in (("one.ply", 5), ("maps/two.png", 7)):
        (tmp_path / name).write_bytes(b"x" * size)
    assert bench.measure_bytes([tmp_path / "one.ply", tmp_path / "maps"]) == 12


def test_a_higher_cost_is_bold() -> None:
    before = {"wall_s": 1.0, "cpu_s": 2.0, "peak_mb": 100.0, "bytes": 0}
    cost = {"wall_s": 1.1, "cpu_s": 2.6, "peak_mb": 50.0, "bytes": 3}
    assert bench.make_cells(cost, None) == ["1.1", "2.6", "50", "3"]
    assert bench.make_cells(cost, before) == ["1.1", "1.10", "2.6", "**1.30**", "50", "0.50", "3", "–"]
    assert bench.make_cells(cost, {})[1] == "–"


@pytest.mark.slow
def test_all_stages_of_a_run_are_measured(tmp_path: Path) -> None:
    costs = bench.measure_run(write_small_scan(tmp_path / "scan"))
    total = costs.pop("total")
    assert {"fuse", "clean", "simplify", "report"} <= costs.keys()
    assert costs["fuse"]["bytes"] > 1000
    assert all(one["cpu_s"] > 0 and one["wall_s"] > 0 and one["peak_mb"] > 50 for one in costs.values())
    assert total["wall_s"] >= sum(one["wall_s"] for one in costs.values())
    assert total["bytes"] > sum(one["bytes"] for one in costs.values()), "the page and report.json are added"


@pytest.mark.slow
def test_a_profile_names_stages_and_functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS_VARIABLE, "2")  # restored afterwards
    rows = bench.profile_run(write_small_scan(tmp_path / "scan"))
    assert ("fuse", "Volume.integrate") in {(stage, name) for stage, name, _ in rows}
    assert sum(share for *_, share in rows) == pytest.approx(1)
    assert rows[0][2] == max(share for *_, share in rows)


@pytest.mark.parametrize(
    ("key", "name"),
    [
        (("~", 0, "<method 'integrate' of 'scanloom.stages._kernels.Volume' objects>"), "Volume.integrate"),
        (("~", 0, "<built-in method scanloom.stages._kernels.match_descriptors>"), "match_descriptors"),
        (("~", 0, "<imdecode>"), "imdecode"),
        (("stages/adjusting/adjust.py", 12, "adjust"), "adjust.adjust"),
    ],
)
def test_names_of_functions_are_short(key: tuple[str, int, str], name: str) -> None:
    assert bench.name_function(*key) == name
