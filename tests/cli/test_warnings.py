"""What changes a result is told whatever is silenced, in one line, and in JSON; --strict makes it count."""

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
def odd_scan(tiny_scan: Path, tmp_path: Path) -> Path:
    """A scan whose times are odd: two frames have the same."""
    folder = tmp_path / "scan"
    shutil.copytree(tiny_scan, folder)
    document = json.loads((folder / "scan.json").read_text())
    for number, frame in enumerate(document["frames"]):
        frame["timestamp"] = 33_000_000 * max(number, 1)
    (folder / "scan.json").write_text(json.dumps(document))
    return folder


@pytest.fixture
def faces(tmp_path: Path) -> Path:
    """A PLY file with colours of its faces alone, which are not used."""
    path = tmp_path / "faces.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 9 9 9\n"
    )
    return path


@pytest.mark.parametrize("switches", [(), ("--quiet",), ("--json",), ("--quiet", "--json")])
def test_a_warning_is_told_whatever_is_silenced(
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


def test_that_polygons_became_triangles_is_only_remarked(scanloom: Run, tmp_path: Path) -> None:
    square = tmp_path / "square.obj"
    square.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    words = ("clean", square, tmp_path / "out.ply", "--strict")
    assert f"{square}: 1 polygons were split into triangles" in scanloom(*words).stderr.splitlines()
    quiet = scanloom(*words, "--quiet")
    assert (quiet.exit_code, quiet.stderr) == (0, "")


def test_colours_that_a_format_cannot_hold_are_warned_of(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    ran = scanloom("clean", ball, tmp_path / "out.stl", "--quiet")
    assert ran.exit_code == 0
    assert ran.stderr.startswith(f"warning: {tmp_path / 'out.stl'}: .stl stores geometry only")
    assert scanloom("clean", ball, tmp_path / "out.obj", "--quiet").stderr == ""


def test_textures_that_a_method_leaves_out_are_warned_of(scanloom: Run, tmp_path: Path) -> None:
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


def test_what_is_odd_about_a_scan_is_told_by_every_command_that_reads_it(
    scanloom: Run, odd_scan: Path, tmp_path: Path
) -> None:
    odd = "1 timestamps are repeated"
    cache = ("--set", f"run.cache={tmp_path / 'cache'}", "--until", "fuse")
    for words in (
        ("fuse", odd_scan, tmp_path / "fused.ply"),
        ("run", odd_scan, "-o", tmp_path / "out", *cache),
        ("render", tmp_path / "fused.ply", tmp_path / "p.png", "--scan", odd_scan, "--width", 64),
    ):
        ran = scanloom(*words, "--quiet", "--json")
        assert ran.exit_code == 0, ran.stderr
        assert odd in ran.warnings, words
        assert f"warning: {odd}" in ran.stderr.splitlines()
        assert scanloom(*words, "--strict").exit_code == 1
    ran = scanloom("inspect", odd_scan, "--json", "--strict")
    assert ran.exit_code == 1
    assert odd in ran.warnings
    # There it is the answer, and not said twice.
    assert f"warning: {odd}" not in scanloom("inspect", odd_scan).stderr
    assert odd in scanloom("inspect", odd_scan).stdout


def test_json_has_warnings_also_where_there_are_none(scanloom: Run, clean_ball: Path, tmp_path: Path) -> None:
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
def test_what_a_library_warns_of_is_a_line_too(
    scanloom: Run, ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cleaned = stages.clean

    def warning_of(*given: Any) -> Any:
        warnings.warn("overflow\nin a library", RuntimeWarning, stacklevel=1)
        return cleaned(*given)

    monkeypatch.setattr("scanloom.stages.clean", warning_of)
    ran = scanloom("clean", ball, tmp_path / "out.ply", "--quiet", "--strict", "--json")
    assert ran.exit_code == 1
    assert ran.warnings == ["overflow\nin a library"]
    assert ran.json["diagnostics"][0]["code"] == "machine.library-warning"
    assert ran.stderr.splitlines()[0] == "warning: overflow\\nin a library"
    assert len(ran.stderr.splitlines()) == 2


def test_a_message_is_one_line_whatever_a_file_is_called(scanloom: Run, faces: Path, tmp_path: Path) -> None:
    odd = tmp_path / "two\nlines\x1b[31m.ply"
    shutil.copy(faces, odd)
    ran = scanloom("clean", odd, tmp_path / "out.ply")
    lines = ran.stderr.splitlines()
    assert lines[0].startswith(f"warning: {tmp_path}/two\\nlines\\x1b[31m.ply: face colours")
    assert len(lines) == 2
    missing = scanloom("clean", tmp_path / "no\nsuch.ply", tmp_path / "out.ply")
    assert missing.exit_code == 3
    assert missing.stderr.splitlines() == [f"scanloom: {tmp_path}/no\\nsuch.ply: there is no such file."]


def test_a_warning_is_told_once_and_what_was_not_reached_too(capsys: pytest.CaptureFixture[str]) -> None:
    out = Output(quiet=True, can_warn=True)
    for _ in range(2):
        out.report(MACHINE_BUG.warning("odd"))
        out.report(MACHINE_BUG.unmet("far"))
    out.report(MACHINE_BUG.info("silent"))
    out.result({}, "text")
    assert capsys.readouterr().err.splitlines() == ["warning: odd", "scanloom: far"]
    assert out.exit_code == 1


def test_a_mesh_without_colours_loses_none(scanloom: Run, tmp_path: Path) -> None:
    plain = tmp_path / "plain.ply"
    write_ply(plain, Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32)))
    assert scanloom("clean", plain, tmp_path / "out.stl", "--quiet", "--strict").stderr == ""


def test_that_another_run_is_waited_for_is_said_at_once_and_only_remarked(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for quiet, said in ((False, ["waits"]), (True, [])):
        with show_run_progress(Output(quiet=quiet)) as events:
            events(RunWaiting("waits"))
            assert capsys.readouterr().err.splitlines() == said


def test_parameters_are_options_and_stages_are_named() -> None:
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
