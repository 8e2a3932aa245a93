"""Command `view`: serves tiles to a browser on the same machine until Ctrl-C."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browsers import launch_browser
from coloured_meshes import sheet

from scanloom.stages import lod
from scanloom.stages.surface.formats.ply import read_ply

Run = Callable[..., Any]


@pytest.mark.slow
def test_tiles_without_a_page_are_shown_and_nothing_is_written(tmp_path: Path) -> None:
    hierarchy = lod.build(sheet(8), cell_triangles=128, root_triangles=100, ratio=4.0, threads=1)
    lod.write_tiles(hierarchy, tmp_path / "tiles")
    before = sorted(tmp_path.rglob("*"))
    words = [sys.executable, "-m", "scanloom.cli.app", "view", str(tmp_path / "tiles"), "--no-open"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as started:
        try:
            assert started.stdout is not None
            address = started.stdout.readline().split()[0]
            for name in ("", "page/library.js", "page/tiles/main.js", "tileset.json", "tiles/0.glb"):
                with urllib.request.urlopen(address + name, timeout=20) as answer:
                    assert answer.read()
            started.send_signal(signal.SIGINT)
            assert started.wait(20) == 0
            assert started.stderr is not None
            assert started.stderr.read() == "Ended.\n"
        finally:
            started.kill()
    assert sorted(tmp_path.rglob("*")) == before


def test_json_has_the_address_and_open_starts_a_browser(
    scanloom: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from scanloom.pipeline.report.page.folder_server import FolderServer

    def raise_interrupt(self: FolderServer) -> None:  # noqa: ARG001
        raise KeyboardInterrupt

    asked: list[str] = []
    monkeypatch.setattr(FolderServer, "serve_forever", raise_interrupt)
    monkeypatch.setattr("webbrowser.open_new_tab", asked.append)
    (tmp_path / "tileset.json").write_text("{}")
    ran = scanloom("view", tmp_path, "--json", "--open")
    assert (ran.exit_code, ran.stderr) == (0, "")
    assert asked == [json.loads(ran.stdout)["address"]]
    assert scanloom("view", tmp_path).exit_code == 0
    assert len(asked) == 1


@pytest.mark.slow
def test_the_crop_box_of_a_page_is_an_option_of_fuse(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    fuse = ("fuse", tiny_scan, "--voxel-size", 0.02)
    assert scanloom(*fuse, tmp_path / "ball.ply").exit_code == 0
    assert scanloom("view", tmp_path / "ball.ply", "-o", tmp_path / "ball.html").exit_code == 0
    with launch_browser() as chromium:
        page = chromium.new_page()
        page.goto((tmp_path / "ball.html").as_uri())
        page.wait_for_selector("#message", state="hidden", timeout=60_000)
        page.select_option("#cut", "box")
        for name, value in (("Lowest x", "-0.15"), ("Highest y", "0.1"), ("Highest z", "1.1")):
            page.get_by_label(name, exact=True).fill(value)
            page.keyboard.press("Tab")
        option = page.inner_text("#option").split()
    ran = scanloom(*fuse, *option, tmp_path / "cropped.ply", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["crop"]["box_m"] == [float(word) for word in option[1:]]
    low, high = np.array(option[1:4], float), np.array(option[4:], float)
    assert (low[0], high[1], high[2]) == (-0.15, 0.1, 1.1)
    full, cropped = (read_ply(tmp_path / f"{name}.ply").vertices for name in ("ball", "cropped"))
    assert (cropped > low - 0.02).all()
    assert (cropped < high + 0.02).all()
    inside = full[((full > low + 0.04) & (full < high - 0.04)).all(axis=1)]
    assert 100 < len(inside) < len(full)
    assert {tuple(row) for row in inside.tolist()} <= {tuple(row) for row in cropped.tolist()}


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("absent",), 3, "absent: there is no such file or folder."),
        (
            ("empty",),
            3,
            "empty: the folder has none of textured.glb, simplified.glb, simplified.ply, nor tiles; ",
        ),
        (("empty", "--port", "70000"), 2, "less than or equal to 65535"),
    ],
)
def test_bad_input_is_one_error(
    scanloom: Run,
    words: tuple[str, ...],
    code: int,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    ran = scanloom("view", *words)
    assert ran.exit_code == code
    assert message in ran.stderr
    assert len(ran.stderr.splitlines()) == 1


def test_the_page_of_a_mesh_is_a_single_file(scanloom: Run, clean_ball: Path, tmp_path: Path) -> None:
    target = tmp_path / "new" / "page.html"
    ran = scanloom("view", clean_ball, "-o", target, "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["bytes"] == target.stat().st_size < 2_000_000
    text = target.read_text()
    assert "http:" not in text.split("<!--")[0].replace("http://www.w3.org", "")
    small = scanloom("view", clean_ball, "-o", target, "--set", "page.size=1.2", "--json")
    assert small.exit_code == 0


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("none.ply",), 3, "no such file or folder"),
        ((".",), 3, "the folder has none of textured.glb"),
        (("none.ply", "-o", "page.txt"), 2, "unknown file extension"),
        (("notes.txt",), 3, "unknown format"),
        (("tiles", "-o", "page.html"), 2, "tiles cannot be written as a single file"),
    ],
)
def test_input_that_cannot_be_shown_is_reported(
    scanloom: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    code: int,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("mine")
    Path("tiles").mkdir()
    Path("tiles/tileset.json").write_text("{}")
    ran = scanloom("view", *words)
    assert (ran.exit_code, message in ran.stderr) == (code, True), ran.stderr
    assert not Path("page.html").exists()
