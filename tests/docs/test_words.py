"""Command lines of pages can be parsed, and the tutorial and the recipes run as written."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from small_sample import write_small_sample
from typer.main import get_command

from scanloom import read_mesh, write_mesh
from scanloom.cli.app import app, run_command
from scanloom.cli.command_table import load_command
from scanloom.cli.options import set_sections
from scanloom.pipeline.sections import read_assignments

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = ("README.md", *(path.relative_to(ROOT).as_posix() for path in sorted(DOCS.rglob("*.md"))))


def list_command_lines(page: str) -> list[str]:
    """List the command lines of a page: in code blocks without a language, without trailing comments."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^ *```([^\n]*)\n(.*?)^ *```$", text, flags=re.MULTILINE | re.DOTALL)
    lines = [line.strip() for language, block in blocks if not language for line in block.splitlines()]
    return [re.sub(r"\s+#.*", "", line) for line in lines if line.startswith("scanloom ")]


@pytest.mark.parametrize("page", [page for page in PAGES if list_command_lines(page)])
def test_every_command_line_of_a_page_can_be_parsed(page: str):
    for line in list_command_lines(page):
        _, *words = shlex.split(line)
        command = get_command(app())
        names = []
        while hasattr(command, "commands"):
            name, *words = words
            assert name in command.commands, line
            names.append(name)
            command = command.commands[name]
        context = command.make_context(line, words)
        sections = set_sections(load_command(tuple(names)))
        list(read_assignments(context.params.get("set_words") or (), sections))


def run_lines(lines: list[str]) -> None:
    for line in lines:
        assert run_command(shlex.split(line)[1:]) == 0, line


@pytest.fixture
def small_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a folder laid out like the pages assume, with the small sample."""
    write_small_sample(tmp_path / "samples" / "rgbd")
    shutil.copy(ROOT / "samples" / "truth.ply", tmp_path / "samples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_tutorial_runs(small_sample: Path, capsys: pytest.CaptureFixture[str]):
    lines = [line for line in list_command_lines("docs/tutorial.md") if "MY_SCAN" not in line]

    # The report of the second run is sufficient.
    without = "--set report.enabled=false"
    run_lines([f"{line} {without}" if line.endswith("-o my_mesh") else line for line in lines[:-1]])

    assert len(lines) == 7
    assert "params changed: max_shape not set → 0.005" in capsys.readouterr().err
    report = json.loads((small_sample / "my_mesh" / "report.json").read_text())
    assert report["stages"]["fuse"]["cached"]
    details = report["stages"]["simplify"]["metrics"]["details"]
    assert details["proven"]
    assert details["shape_bound_m"] <= 0.005
    sizes = {name: (small_sample / name).stat().st_size for name in ("web.glb", "my_mesh/textured.glb")}
    assert sizes["web.glb"] < sizes["my_mesh/textured.glb"] / 2
    for name in ("scan.png", "result.png", "triangles.png", "my_mesh/report.html"):
        assert (small_sample / name).stat().st_size > 10_000


@pytest.mark.slow
def test_two_scans_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    mesh = read_mesh(ROOT / "samples" / "truth.ply")
    write_mesh(tmp_path / "before.ply", mesh)
    # Remove the globe and shift the rest by a millimetre.
    middles = mesh.vertices[mesh.triangles].mean(axis=1)
    stays = np.linalg.norm(middles - (0.17, -0.12, 0.095), axis=1) > 0.1
    moved = mesh.with_(vertices=mesh.vertices + np.array((0.001, 0, 0)), triangles=mesh.triangles[stays])
    write_mesh(tmp_path / "after.ply", moved)
    lines = list_command_lines("docs/recipes/compare.md")

    # The third command includes the others, except for a picture.
    run_lines([f"{lines[2]} --picture off.png"])

    assert len(lines) == 4
    told = capsys.readouterr().out
    assert re.search(r"B was aligned with A: moved by 1\.00\d mm RMS", told)
    assert "New in B: 0 m² in 0 regions; removed from A: 0.1016 m² in 1 region;" in told
    for name in ("off.png", "change.ply"):
        assert (tmp_path / name).stat().st_size > 10_000


def test_a_textured_model_is_simplified(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    shutil.copy(shared_data / "meshes" / "Duck.glb", tmp_path / "model.glb")

    run_lines([line for line in list_command_lines("docs/recipes/lighter.md") if "compare" not in line])

    assert "Proven: no point is more than 0.005 m off." in capsys.readouterr().out
    assert len(read_mesh(tmp_path / "lighter.glb").triangles) <= 1000
    assert len(read_mesh(tmp_path / "light.glb").triangles) == len(read_mesh(tmp_path / "web.glb").triangles)


@pytest.mark.parametrize(
    ("page", "folder", "named"),
    [
        ("realsense.md", "rgbd/realsense_desk_tum_layout", "desk"),
        ("kitti.md", "stereo/kitti_sequence_1", "street"),
    ],
)
def test_scans_of_recipes_are_processed_as_described(
    shared_data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    page: str,
    folder: str,
    named: str,
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / named).symlink_to(shared_data / folder)
    lines = list_command_lines(f"docs/recipes/{page}")
    text = (DOCS / "recipes" / page).read_text()

    # A full run takes 30 to 60 s; a dry run already reports the method.
    run_lines([f"{line} --dry-run" for line in lines if line.startswith("scanloom run")])
    run_lines([line for line in lines if line.startswith("scanloom inspect")][:1])

    told = capsys.readouterr()
    (shown,) = re.findall(r"```text\n(.*?)```", text, flags=re.DOTALL)
    for line in shown.strip().splitlines():
        assert line in told.out
