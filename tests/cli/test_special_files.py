"""Pipes, devices, sockets, circular links and invalid names give one error, and no command blocks."""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")

COMMANDS = (
    (".ply", "simplify {} -o o.ply --ratio 0.5"),
    (".ply", "compare {} ball.ply"),
    (".ply", "check {}"),
    (".ply", "mesh certify {} ball.ply"),
    (".obj", "check {}"),
    (".glb", "check {}"),
    (".off", "check {}"),
    (".stl", "check {}"),
    (".snm", "mesh decode {} -o o.ply"),
    (".npz", "mesh replay {} -o o.ply --ratio 0.5"),
    (".toml", "run scan -o out --config {}"),
    (".toml", "run scan -o out --set scan.calibration={}"),
    (".txt", "run scan -o out --set scan.poses={}"),
    (".txt", "run scan -o out --set scan.adjusted_cameras={}"),
    (".txt", "run scan -o out --set scan.depth_calibration={}"),
    ("", "inspect {}"),
    (".bag", "inspect {}"),
    (".mcap", "inspect {}"),
    (".sens", "inspect {}"),
    (".r3d", "inspect {}"),
    ("", "worker {}"),
)
KINDS = ("pipe", "socket", "device", "log", "loop", "missing", "long", "null")


def make_special_file(kind: str, extension: str) -> str:
    """Make a special file in the current folder and return its path."""
    path = Path(f"special{extension}")
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "socket":
            with socket.socket(socket.AF_UNIX) as made:
                made.bind(str(path))
        case "device":
            path.symlink_to("/dev/zero")
        case "log":  # reading it blocks
            path.symlink_to("/dev/kmsg")
        case "loop":
            path.symlink_to(path)
        case "missing":
            path.symlink_to("none")
        case "long":
            return "a" * 300 + extension
        case "null":
            return f"a\0b{extension}"
    return str(path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("extension", "command"), COMMANDS)
def test_no_special_file_blocks_or_counts_as_a_bug(
    scanloom: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    tiny_scan: Path,
    made_ball: Path,
    kind: str,
    extension: str,
    command: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scan").symlink_to(tiny_scan)
    shutil.copy(made_ball, "ball.ply")
    name = make_special_file(kind, extension)
    done = scanloom(*(word.format(name) for word in command.split()))
    assert done.exit_code in (2, 3), done.stderr
    assert "bug in scanloom" not in done.stderr
    assert len(done.stderr.splitlines()) <= 3
