"""Warnings: printed even with --quiet, on one line, also in JSON, and counted by --strict."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom import Mesh, stages
from scanloom.cli.output import Output
from scanloom.cli.rendering import render
from scanloom.cli.run_progress import show_run_progress
from scanloom.pipeline.run.events import RunWaiting
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.surface.formats.ply import write_ply

Run = Callable[..., Any]


@pytest.fixture
def scan_with_repeated_time(tiny_scan: Path, tmp_path: Path) -> Path:
    """Copy the tiny scan, with the same timestamp for two frames."""
    folder = tmp_path / "scan"
    shutil.copytree(tiny_scan, folder)
    document = json.loads((folder / "scan.json").read_text())
    for number, frame in enumerate(document["frames"]):
        frame["timestamp"] = 33_000_000 * max(number, 1)
    (folder / "scan.json").write_text(json.dumps(document))
    return folder


@pytest.fixture
def faces(tmp_path: Path) -> Path:
    """Write a PLY file with face colours, which are not used."""
    path = tmp_path / "faces.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 9 9 9\n"
    )
    return path


@pytest.mark.parametrize("switches", [(), ("--quiet",), ("--json",), ("--quiet", "--json")])
def test_a_warning_is_printed_even_with_quiet(
    scanloom: Run, faces: Path, tmp_path: Path, switches: tuple[str, ...]
) -> None:
    ran = scanloom("clean", faces, tmp_path / "out.ply", *switches)
    assert ran.exit_code == 0
    warned = f"warning: {faces}: face colours are left out; only vertex colours are used"
    assert warned in ran.stderr.splitlines()
    if switches:
        assert ran.stderr.splitlines() == [warned]
    if "--json" in switches:
        assert ran.warnings == [warned.removeprefix("warning: ")]


def test_strict_counts_warnings_and_writes_the_result(scanloom: Run, faces: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.ply"
    ran = scanloom("clean", faces, target, "--strict", "--json")
    assert ran.exit_code == 1
    assert target.is_file()
    assert len(ran.warnings) == 1
    assert ran.stderr.splitlines()[-1].startswith("scanloom: ")
    assert scanloom("clean", target, target, "--strict").exit_code == 0


def test_splitting_polygons_is_an_info_message(scanloom: Run, tmp_path: Path) -> None:
    square = tmp_path / "square.obj"
    square.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    words = ("clean", square, tmp_path / "out.ply", "--strict")
    assert f"{square}: 1 polygons were split into triangles" in scanloom(*words).stderr.splitlines()
    quiet = scanloom(*words, "--quiet")
    assert (quiet.exit_code, quiet.stderr) == (0, "")


def test_a_format_without_colours_warns(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    ran = scanloom("clean", ball, tmp_path / "out.stl", "--quiet")
    assert ran.exit_code == 0
    assert ran.stderr.startswith(f"warning: {tmp_path / 'out.stl'}: .stl stores geometry only")
    assert scanloom("clean", ball, tmp_path / "out.obj", "--quiet").stderr == ""


def test_a_method_that_discards_parts_warns(scanloom: Run, tmp_path: Path) -> None:
    model = tmp_path / "parts.obj"
    rows = "".join(f"v {x} {y} 0\n" for y in range(3) for x in range(3))
    quads = [(a, a + 1, a + 4, a + 3) for a in (1, 2, 4, 5)]
    for part, some in (("left", quads[::2]), ("right", quads[1::2])):
        rows += f"o {part}\n" + "".join(f"f {a} {b} {c}\nf {a} {c} {d}\n" for a, b, c, d in some)
    model.write_text(rows)
    words = ("simplify", model, tmp_path / "out.ply", "--method", "quadric", "--ratio", 0.9, "--quiet")
    assert (
        f"warning: {model}: simplify discards parts; method seams preserves them." in scanloom(*words).stderr
    )


def test_every_command_that_reads_a_scan_prints_its_warnings(
    scanloom: Run, scan_with_repeated_time: Path, tmp_path: Path
) -> None:
    odd = "1 timestamps are repeated"
    cache = ("--set", f"run.cache={tmp_path / 'cache'}", "--until", "fuse")
    for words in (
        ("fuse", scan_with_repeated_time, tmp_path / "fused.ply"),
        ("run", scan_with_repeated_time, "-o", tmp_path / "out", *cache),
        (
            "render",
            tmp_path / "fused.ply",
            tmp_path / "p.png",
            "--scan",
            scan_with_repeated_time,
            "--width",
            64,
        ),
    ):
        ran = scanloom(*words, "--quiet", "--json")
        assert ran.exit_code == 0, ran.stderr
        assert odd in ran.warnings, words
        assert f"warning: {odd}" in ran.stderr.splitlines()
        assert scanloom(*words, "--strict").exit_code == 1
    ran = scanloom("inspect", scan_with_repeated_time, "--json", "--strict")
    assert ran.exit_code == 1
    assert odd in ran.warnings
    # In `inspect` the warning is part of the result, so stderr does not repeat it.
    assert f"warning: {odd}" not in scanloom("inspect", scan_with_repeated_time).stderr
    assert odd in scanloom("inspect", scan_with_repeated_time).stdout


def test_json_has_an_empty_list_of_warnings(scanloom: Run, clean_ball: Path, tmp_path: Path) -> None:
    light = tmp_path / "light.ply"
    for words in (
        ("clean", clean_ball, light),
        ("simplify", clean_ball, light, "--ratio", 0.5),
        ("compare", clean_ball, light, "--set", "compare.samples=1000"),
        ("mesh", "certify", light, clean_ball, "--max-shape", 1, "--check-only"),
        ("mesh", "patches", clean_ball, light),
        ("render", light, tmp_path / "p.png", "--width", 64),
    ):
        ran = scanloom(*words, "--json")
        assert (ran.exit_code, ran.stderr, ran.warnings) == (0, "", []), words


@pytest.mark.filterwarnings("default")
def test_a_warning_of_a_library_is_printed_on_one_line(
    scanloom: Run, ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cleaned = stages.clean

    def clean_with_warning(*given: Any) -> Any:
        warnings.warn("overflow\nin a library", RuntimeWarning, stacklevel=1)
        return cleaned(*given)

    monkeypatch.setattr("scanloom.stages.clean", clean_with_warning)
    ran = scanloom("clean", ball, tmp_path / "out.ply", "--quiet", "--strict", "--json")
    assert ran.exit_code == 1
    assert ran.warnings == ["overflow\nin a library"]
    assert ran.json["diagnostics"][0]["code"] == "machine.library-warning"
    assert ran.stderr.splitlines()[0] == "warning: overflow\\nin a library"
    assert len(ran.stderr.splitlines()) == 2


def test_line_breaks_in_file_names_are_escaped(scanloom: Run, faces: Path, tmp_path: Path) -> None:
    odd = tmp_path / "two\nlines\x1b[31m.ply"
    shutil.copy(faces, odd)
    ran = scanloom("clean", odd, tmp_path / "out.ply")
    lines = ran.stderr.splitlines()
    assert lines[0].startswith(f"warning: {tmp_path}/two\\nlines\\x1b[31m.ply: face colours")
    assert len(lines) == 2
    missing = scanloom("clean", tmp_path / "no\nsuch.ply", tmp_path / "out.ply")
    assert missing.exit_code == 3
    assert missing.stderr.splitlines() == [f"scanloom: {tmp_path}/no\\nsuch.ply: there is no such file."]


def test_repeated_warnings_and_unmet_requirements_are_printed_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = Output(quiet=True, can_warn=True)
    for _ in range(2):
        out.report(MACHINE_BUG.warning("odd"))
        out.report(MACHINE_BUG.unmet("far"))
    out.report(MACHINE_BUG.info("silent"))
    out.result({}, "text")
    assert capsys.readouterr().err.splitlines() == ["warning: odd", "scanloom: far"]
    assert out.exit_code == 1


def test_a_format_without_colours_does_not_warn_for_a_plain_mesh(scanloom: Run, tmp_path: Path) -> None:
    plain = tmp_path / "plain.ply"
    write_ply(plain, Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32)))
    assert scanloom("clean", plain, tmp_path / "out.stl", "--quiet", "--strict").stderr == ""


def test_waiting_for_another_run_is_reported_at_once_unless_quiet(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for quiet, message in ((False, ["waits"]), (True, [])):
        with show_run_progress(Output(quiet=quiet)) as events:
            events(RunWaiting("waits"))
            assert capsys.readouterr().err.splitlines() == message


def test_messages_name_options_and_stages() -> None:
    about = UsageError(
        MACHINE_BUG, "is {value}.", DiagnosticLocation(parameter="voxel_size"), value=0
    ).diagnostic
    assert render(about) == "--voxel-size is 0."
    assert (
        render(about.replace_location_fields(section="fuse", file="a.toml"))
        == "a.toml: fuse.voxel_size is 0."
    )
    advice = MACHINE_BUG.warning("odd", "a.png", remedy="set scan.depth_scale=1000").replace_location_fields(
        stage="fuse"
    )
    assert render(advice) == "fuse: a.png: odd; give --set scan.depth_scale=1000"
    assert str(advice) == "fuse: a.png: odd; set scan.depth_scale=1000"
