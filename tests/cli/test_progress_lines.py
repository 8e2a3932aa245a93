"""Without a terminal, progress is printed as lines, at least every 30 seconds."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scanloom.cli import progress_lines
from scanloom.cli.output import Output
from scanloom.cli.transient_progress import TransientProgress

Run = Callable[..., Any]


def test_progress_lines_appear_without_progress_calls(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress_lines, "INTERVAL_S", 0.02)
    with Output().progress("adjust", "frames") as progress:
        time.sleep(0.1)
        progress(3, 1200)
        time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "adjust: running for 0 s"
    assert lines[-1] == "adjust: running for 0 s, 3 of 1,200 frames"
    with Output(quiet=True).progress("adjust", "frames"):
        time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_a_remark_ends_the_progress_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress_lines, "INTERVAL_S", 0.02)
    out = Output()
    bar = TransientProgress(out)
    bar.show("fuse", "frames")
    time.sleep(0.1)
    out.remark("done")
    time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "fuse: running for 0 s"
    assert lines[-1] == "done"


def test_a_run_announces_each_stage_that_starts(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    words = ("run", tiny_scan, "-o", tmp_path / "out", "--until", "fuse")
    lines = scanloom(*words).stderr.splitlines()
    assert "fuse: started (first run)" in lines
    assert lines.index("fuse: started (first run)") < next(
        n for n, line in enumerate(lines) if line.startswith("fuse ")
    )
    assert not any(": started" in line for line in scanloom(*words).stderr.splitlines()), "all is cached"
    assert scanloom(*words, "--set", "run.force=fuse", "--quiet").stderr == ""
