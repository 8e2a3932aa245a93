"""Fixtures of the command tests: a scan that runs in two seconds, a mesh, and the command line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from scanloom.cli.app import run_command
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh

CAMERA = Camera(width=96, height=72, fx=80.0, fy=80.0, cx=47.5, cy=35.5)
WALL, CENTRE, RADIUS = 1.2, np.array([0.0, 0.0, 1.0]), 0.25


def render_depth(x: float) -> np.ndarray:
    """Render the depth map of the ball and the wall, metres, from a camera at (x, 0, 0) along +z."""
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    origin = np.array([x, 0.0, 0.0]) - CENTRE
    a, b = (rays**2).sum(-1), rays @ origin
    root = b * b - a * (origin @ origin - RADIUS**2)
    ball = (-b - np.sqrt(np.maximum(root, 0))) / a
    return np.where(root > 0, ball, WALL)


@pytest.fixture(scope="session")
def tiny_scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write six RGB-D frames of a ball in front of a wall, in the plain layout."""
    folder = tmp_path_factory.mktemp("tiny_scan")
    frames = []
    for i, x in enumerate(np.linspace(-0.1, 0.1, 6)):
        depth = np.rint(render_depth(x) * 1000).astype(np.uint16)
        color = np.where((depth < 1200)[..., None], (40, 80, 200), (180, 180, 160)).astype(np.uint8)
        files = {kind: folder / f"{kind}-{i}.png" for kind in ("color", "depth")}
        cv2.imwrite(str(files["depth"]), depth)
        cv2.imwrite(str(files["color"]), color)
        pose = np.eye(4)
        pose[0, 3] = x
        frames.append(Frame(f"{i}", CAMERA, files["color"], depth=files["depth"], world_from_camera=pose))
    write_scan_json(folder, frames)
    return folder


@pytest.fixture(scope="session")
def made_ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a coloured ball of 1 m radius as PLY: 1,280 triangles, and one distant speck."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=3)
    vertices = np.vstack([mesh.vertices, [[9, 9, 9], [9.001, 9, 9], [9, 9.001, 9]]])
    triangles = np.vstack([mesh.faces, [[len(mesh.vertices) + i for i in range(3)]]])
    colors = np.clip(128 + 100 * vertices, 0, 255).astype(np.uint8)
    path = tmp_path_factory.mktemp("made") / "ball.ply"
    write_ply(path, Mesh(vertices, triangles.astype(np.int32), colors))
    return path


@pytest.fixture(scope="session")
def made_clean_ball(made_ball: Path) -> Path:
    """Clean the ball with `scanloom clean`."""
    path = made_ball.with_name("clean.ply")
    assert run_command(["clean", str(made_ball), str(path)]) == 0
    return path


@pytest.fixture
def ball(made_ball: Path, tmp_path: Path) -> Path:
    """Copy the ball for one test."""
    return Path(shutil.copy(made_ball, tmp_path))


@pytest.fixture
def clean_ball(made_clean_ball: Path, ball: Path) -> Path:
    """Copy the clean ball for one test, next to the ball."""
    return Path(shutil.copy(made_clean_ball, ball.parent))


@dataclass(frozen=True)
class CommandResult:
    """Exit code and output of a command line."""

    exit_code: int
    stdout: str
    stderr: str

    @property
    def json(self) -> Any:
        return json.loads(self.stdout)

    @property
    def warnings(self) -> list[str]:
        return self._list_messages("warning")

    @property
    def unmet(self) -> list[str]:
        return self._list_messages("unmet")

    def _list_messages(self, severity: str) -> list[str]:
        found = [one for one in self.json["diagnostics"] if one["severity"] == severity]
        return [str(Diagnostic.from_dict(one)) for one in found]


@pytest.fixture
def scanloom(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., CommandResult]:
    """Run command lines in this process, with the exit code of the installed command."""
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words: object) -> CommandResult:
        capsys.readouterr()
        code = run_command([str(word) for word in words])
        captured = capsys.readouterr()
        return CommandResult(code, captured.out, captured.err)

    return run
