"""Exit codes: the same table in the program and the README, and the codes of commands."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from scanloom.cli.exit_codes import MEANINGS, summarize
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.surface.formats.ply import read_ply, write_ply
from scanloom.stages.surface.mesh import Mesh

Run = Callable[..., Any]
ROOT = Path(__file__).parents[2]


@pytest.fixture
def pieces(tmp_path: Path) -> Path:
    """Write five balls as PLY; their simplified mesh has at least 20 triangles, as all components stay."""
    one = trimesh.creation.icosphere(subdivisions=1)
    vertices = np.vstack([one.vertices + np.array([3.0 * i, 0, 0]) for i in range(5)])
    triangles = np.vstack([one.faces + i * len(one.vertices) for i in range(5)])
    path = tmp_path / "pieces.ply"
    write_ply(path, Mesh(vertices, triangles.astype(np.int32)))
    return path


def test_the_readme_has_the_table_of_the_program() -> None:
    section = (ROOT / "README.md").read_text(encoding="utf-8").split("\n## Exit codes\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (\d+) \| ([^|:]+?)(?::[^|]*)? \|", section, re.MULTILINE)
    assert {int(code): meaning for code, meaning in rows} == MEANINGS


def test_the_help_summarizes_the_exit_codes(scanloom: Run) -> None:
    text = re.sub(r"\s+", " ", scanloom("--help").stdout)
    assert f"Exit codes: {summarize()}" in text


def test_a_triangle_count_that_is_not_reached_exits_with_1(scanloom: Run, pieces: Path) -> None:
    light = pieces.with_name("light.ply")
    ran = scanloom("simplify", pieces, light, "--triangles", 10, "--json")
    assert ran.exit_code == 1
    left = len(read_ply(light).triangles)
    assert left == ran.json["triangles"] > 10
    (sentence,) = ran.unmet
    assert sentence.startswith(f"{pieces}: {left} triangles are left instead of 10: ")
    assert f"scanloom: {sentence}" in ran.stderr.splitlines()
    assert scanloom("simplify", pieces, light, "--ratio", 0.01, "--quiet").exit_code == 1
    assert scanloom("simplify", pieces, light, "--triangles", 200).exit_code == 0


def test_a_bound_that_stops_before_the_count_exits_with_0(scanloom: Run, pieces: Path) -> None:
    words = ("simplify", pieces, pieces.with_name("light.ply"), "--triangles", 10, "--json")
    by_bounds = scanloom(*words, "--max-shape", 0.01)
    assert (by_bounds.exit_code, by_bounds.json["stopped_by"]) == (0, "bounds")
    assert by_bounds.unmet == []


def test_a_normal_mesh_above_its_max_error_exits_with_1(
    scanloom: Run, clean_ball: Path, tmp_path: Path
) -> None:
    target = tmp_path / "out.ply"
    few = ("--levels", 1, "--base-triangles", 40)
    ran = scanloom("mesh", "remesh", clean_ball, target, *few, "--set", "remesh.max_error=1e-9")
    assert ran.exit_code == 1
    assert target.is_file()
    # The warning appears once.
    assert ran.stderr.count("the finest level is up to") == 1
    assert scanloom("mesh", "remesh", clean_ball, target, *few, "--set", "remesh.max_error=1").exit_code == 0


def test_an_unproven_limit_exits_with_1_and_a_message(scanloom: Run, clean_ball: Path) -> None:
    light = clean_ball.with_name("light.ply")
    scanloom("simplify", clean_ball, light, "--ratio", 0.3)
    ran = scanloom("mesh", "certify", light, clean_ball, "--max-shape", 1e-6)
    assert ran.exit_code == 1
    assert f"scanloom: {light}: the limits are not proven." in ran.stderr
    assert "The limits are not proven." in ran.stdout


def test_a_limit_does_not_loosen_printed_bounds(scanloom: Run, clean_ball: Path) -> None:
    light = clean_ball.with_name("light.ply")
    scanloom("simplify", clean_ball, light, "--ratio", 0.3)
    bound = scanloom("mesh", "certify", light, clean_ball, "--json").json["shape_bound_m"]
    limited = scanloom("mesh", "certify", light, clean_ball, "--max-shape", 0.9, "--json")
    assert limited.exit_code == 0
    assert limited.json["shape_bound_m"] <= bound
    alone = scanloom("mesh", "certify", light, clean_ball, "--check-only")
    assert (alone.exit_code, "--check-only requires a limit" in alone.stderr) == (2, True)
    decided = scanloom("mesh", "certify", light, clean_ball, "--max-shape", 0.9, "--check-only", "--json")
    assert (decided.exit_code, decided.json["shape_bound_m"]) == (0, 0.9)


@pytest.mark.parametrize("command", ["compare", pytest.param("bake", marks=pytest.mark.slow)])
def test_meshes_in_different_coordinates_exit_with_1(
    scanloom: Run, clean_ball: Path, tmp_path: Path, command: str
) -> None:
    ball, far, target = read_ply(clean_ball), tmp_path / "far.ply", tmp_path / "out.glb"
    for away, code in ((1000.0, 1), (2.5, 0)):
        write_ply(far, ball.with_(vertices=ball.vertices + np.array([away, 0, 0])))
        some = (
            ("--set", "compare.samples=1000")
            if command == "compare"
            else (target, "--set", "bake.max_size=64")
        )
        words = ("mesh", command) if command == "bake" else (command,)
        ran = scanloom(*words, clean_ball, far, *some)
        assert ran.exit_code == code, ran.stderr
        assert ("in the same coordinates and unit" in ran.stderr) == bool(code)
        assert ran.stdout
        assert target.is_file() == (command == "bake")


@pytest.mark.slow
def test_a_run_that_misses_its_triangle_count_exits_with_1(
    scanloom: Run, tiny_scan: Path, tmp_path: Path
) -> None:
    words = ("run", tiny_scan, "-o", tmp_path / "out", "--until", "simplify", "--json")
    for _ in ("made", "cached"):
        ran = scanloom(*words, "--set", "simplify.triangles=2")
        assert ran.exit_code == 1, ran.stderr
        (sentence,) = ran.unmet
        assert re.match(r"simplify: [\d,]+ triangles are left instead of 2: ", sentence)
        assert f"scanloom: {sentence}" in ran.stderr.splitlines()
        report = json.loads((tmp_path / "out" / "report.json").read_text())
        (diagnostic,) = [
            one for one in report["stages"]["simplify"]["diagnostics"] if one["severity"] == "unmet"
        ]
        assert str(Diagnostic.from_dict(diagnostic)) == sentence
        assert (diagnostic["code"], diagnostic["severity"]) == ("simplify.count-not-reached", "unmet")
    more = scanloom(*words, "--set", "simplify.triangles=2", "--set", "simplify.max_shape=0.01")
    assert (more.exit_code, more.stderr) == (0, "")


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("wrong.toml", "[fuse", 2),
        ("wrong.toml", "[fuse]\nvoxle_size = 1.0\n", 2),
        ("poses.tum", "no numbers", 3),
    ],
)
def test_bad_poses_exit_with_3_and_a_bad_configuration_with_2(
    scanloom: Run, tiny_scan: Path, tmp_path: Path, name: str, content: str, code: int
) -> None:
    option = "--config" if name == "wrong.toml" else "--poses"
    file = tmp_path / name
    file.write_text(content)
    words = ("run", tiny_scan, "-o", tmp_path / "out", "--until", "fuse")
    ran = scanloom(*words, option, file)
    assert ran.exit_code == code, ran.stderr
    assert name in ran.stderr
    assert ran.stderr.count("\n") == 1
    missing = scanloom(*words, option, tmp_path / f"no-{name}")
    assert missing.exit_code == code, missing.stderr
    assert missing.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ("run", "scan", "-o", "out", "--set", "fuse.voxle_size=1"),
        ("run", "scan", "-o", "out", "--set", "fuze.voxel_size=1"),
        ("run", "scan", "-o", "out", "--until", "cleen"),
        ("simplfy", "a.ply", "b.ply"),
        ("simplify", "a.ply", "b.ply", "--ratioo", "1"),
    ],
)
def test_a_message_suggests_one_correction(
    scanloom: Run, tiny_scan: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = scanloom(*(tiny_scan if word == "scan" else word for word in words))
    assert ran.exit_code == 2
    assert ran.stderr.count("?") <= 1
    assert not re.search(r"\?[.?]|\.\.", ran.stderr)
    assert re.search(r"voxel_size|fuse|clean|simplify|--ratio", ran.stderr)


# The first imports take most of a second; after the longest delay some commands have ended. Even at the
# shortest delay, Ctrl-C is already handled, because the handler is installed after the first import.
@pytest.mark.slow
@pytest.mark.parametrize(
    "program", [["-m", "scanloom.cli.app"], ["-c", "from scanloom.cli.start import main; main()"]]
)
@pytest.mark.parametrize("delay", [0.02, 0.05, 0.1, 0.2, 0.4, 0.8])
def test_ctrl_c_during_imports_prints_one_sentence(program: list[str], delay: float, tmp_path: Path) -> None:
    # Python reports each import when it ends. Signals are handled from the end of `scanloom.cli.interrupts`.
    words = [sys.executable, "-X", "importtime", *program, "clean", "missing.ply", str(tmp_path / "out.ply")]
    started = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert started.stderr is not None
    message = ""
    while "scanloom.cli.interrupts" not in message:
        message = started.stderr.readline()
    time.sleep(delay)
    started.send_signal(signal.SIGINT)
    rest = [line for line in started.communicate(timeout=60)[1].splitlines() if "import time:" not in line]
    if delay <= 0.05:
        assert started.returncode == 130
    if started.returncode == 130:
        assert rest[-1] == "scanloom: Interrupted; finished results are kept."
    assert rest
    assert all(line.startswith("scanloom: ") for line in rest)


def test_a_damaged_image_is_one_line_without_messages_of_opencv(tmp_path):
    for name in ("im2.ppm", "im6.ppm"):
        (tmp_path / name).write_bytes(b"P6\n640 480\n255\n" + bytes(1000))
    words = [sys.executable, "-c", "from scanloom.cli.start import main; main()", "inspect", str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT, timeout=120)
    assert done.returncode == 3
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("scanloom: ")
    assert "im2.ppm: the image" in line
