"""Command `doctor`: text, JSON, and a bundle without private paths."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from scanloom.stages import _kernels

Run = Callable[..., Any]


def test_doctor_lists_libraries_kernels_and_threads(scanloom: Run) -> None:
    ran = scanloom("doctor", "--json")
    assert (ran.exit_code, ran.stderr) == (0, "")
    result = ran.json
    assert result["libraries"]["numpy"] == metadata.version("numpy")
    assert None not in result["libraries"].values()
    assert result["kernels"].endswith(hashlib.sha256(Path(_kernels.__file__).read_bytes()).hexdigest()[:12])
    assert 0 < result["threads"] <= os.cpu_count()
    assert result["disk_free_bytes"] > 0
    text = scanloom("doctor").stdout
    assert metadata.version("trimesh") in text
    assert result["kernels"] in text
    assert result["kernels"] in scanloom("--version").stdout


def test_the_bundle_contains_no_home_path(
    scanloom: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    out = tmp_path / "home" / "out"
    out.mkdir(parents=True)
    (out / "report.json").write_text(json.dumps({"folder": str(out)}))
    (out / "photo.png").write_bytes(b"private")
    ran = scanloom("doctor", "--bundle", tmp_path / "new" / "b.zip", "--run", out)
    assert ran.exit_code == 0, ran.stderr
    with zipfile.ZipFile(tmp_path / "new" / "b.zip") as packed:
        assert sorted(packed.namelist()) == ["doctor.json", "report.json"]
        assert json.loads(packed.read("report.json")) == {"folder": "~/out"}
        assert str(tmp_path / "home").encode() not in packed.read("doctor.json")


@pytest.mark.parametrize("home", ["C:\\Users\\ada", "/home/åda"])
def test_the_bundle_contains_no_escaped_home_path(
    scanloom: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    monkeypatch.setenv("HOME", home)
    for number, is_ascii in enumerate((True, False)):
        out = tmp_path / str(number)
        out.mkdir()
        text = json.dumps({"folder": f"{home}/scan"}, ensure_ascii=is_ascii)
        (out / "report.json").write_text(text, encoding="utf-8")
        ran = scanloom("doctor", "--bundle", out / "b.zip", "--run", out)
        assert ran.exit_code == 0, ran.stderr
        with zipfile.ZipFile(out / "b.zip") as packed:
            assert json.loads(packed.read("report.json")) == {"folder": "~/scan"}


def test_a_platform_note_is_printed_on_a_separate_line(
    scanloom: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scanloom.stages.inspecting.system.is_case_insensitive", lambda folder: True)  # noqa: ARG005
    lines = [line for line in scanloom("doctor").stdout.splitlines() if line.startswith("note: ")]
    assert len(lines) == 1
    assert "upper and lower case" in lines[0]
    assert len(scanloom("doctor", "--json").json["platform_notes"]) == 1


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("--run", "out"), 2, "needs --bundle"),
        (("--bundle", "b.tar"), 2, "unknown file extension"),
        (("--bundle", "b.zip", "--run", "none"), 3, "contains no report.json"),
    ],
)
def test_wrong_doctor_options_are_reported_and_nothing_is_written(
    scanloom: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    code: int,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = scanloom("doctor", *words)
    assert (ran.exit_code, message in ran.stderr) == (code, True)
    assert list(tmp_path.iterdir()) == []
