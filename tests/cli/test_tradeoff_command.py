"""Command `tradeoff`: table, plot and suggested mesh; and `run --plot`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scanloom import load_record, read_mesh

Run = Callable[..., Any]
FEW = ("--set", "tradeoff.steps=4", "--set", "tradeoff.samples=500")


def test_tradeoff_prints_a_table_and_a_suggestion(scanloom: Run, clean_ball: Path) -> None:
    ran = scanloom("mesh", "tradeoff", clean_ball, *FEW, "--set", "tradeoff.glb_bytes=true")
    assert ran.exit_code == 0, ran.stderr
    lines = ran.stdout.splitlines()
    assert lines[0].split()[0] == "triangles"
    assert lines[0].endswith("GLB bytes")
    assert lines[1].startswith("1,280")
    assert lines[-1].startswith("suggested: ")


def test_plot_mesh_and_record_are_saved(scanloom: Run, clean_ball: Path, tmp_path: Path) -> None:
    new = tmp_path / "new"
    kept = ("--plot", new / "c.png", "--save", new / "light.ply", "--save-record", new / "r.npz")
    ran = scanloom(
        "mesh", "tradeoff", clean_ball, "--counts", "600,300,1_000", "--max-distance", 0.1, *kept, "--json"
    )
    assert ran.exit_code == 0, ran.stderr
    assert [point["triangles"] for point in ran.json["points"]] == [1000, 600, 300]
    assert ran.json["suggested_triangles"] == 300
    assert len(read_mesh(new / "light.ply").triangles) == 300
    assert len(load_record(new / "r.npz").replay(triangles=600).mesh.triangles) == 600
    assert (new / "c.png").stat().st_size > 10_000


def test_an_unreachable_distance_exits_with_1(scanloom: Run, clean_ball: Path) -> None:
    ran = scanloom(
        "mesh",
        "tradeoff",
        clean_ball,
        "--counts",
        "100",
        "--set",
        "tradeoff.samples=500",
        "--max-distance",
        1e-6,
    )
    assert ran.exit_code == 1
    assert "no measured triangle count meets 95 % of the surface within 1e-06 m" in ran.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--counts", "5,x"), "--counts has 'x'; give whole numbers, such as 50000,20000,5000."),
        (("--counts", "0"), "counts contains 0; a triangle count must be at least 1."),
        (("--plot", "a.gif"), "a.gif: unknown file extension .gif; use .png, .svg."),
        (("--set", "tradeoff.steps=1"), "--set tradeoff.steps is 1"),
    ],
)
def test_wrong_options_are_reported(
    scanloom: Run, clean_ball: Path, words: tuple[str, ...], message: str
) -> None:
    ran = scanloom("mesh", "tradeoff", clean_ball, *words)
    assert ran.exit_code == 2
    assert message in ran.stderr


@pytest.mark.slow
def test_run_plots_the_duration_of_its_stages(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    words = (
        "run",
        tiny_scan,
        "-o",
        tmp_path / "out",
        "--until",
        "fuse",
        "--set",
        f"run.plot={tmp_path}/p/s.svg",
    )
    assert scanloom(*words).exit_code == 0
    text = (tmp_path / "p" / "s.svg").read_text()
    assert "<!-- fuse -->" in text
    assert "<!-- adjust -->" in text
    assert "(from the cache)" not in text
    assert scanloom(*words).exit_code == 0
    assert "(from the cache)" in (tmp_path / "p" / "s.svg").read_text()
    ran = scanloom(*words, "--dry-run")
    assert (ran.exit_code, ran.stdout) == (2, "")
