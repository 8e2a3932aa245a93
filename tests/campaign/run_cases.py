"""Disturbed runs: killed, with a full disk, or two at once in one folder.

Afterwards, the next run must give the bytes of an undisturbed run.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame
from tests.campaign.verdict import SKIPPED, Verdict, judge

_CAMERA = Camera(64, 48, 55.0, 55.0, 31.5, 23.5)
# Minimum settings, so that a run takes little longer than its imports.
_SMALL = (
    "compare.samples=500",
    "report.viewpoints=1",
    "report.width=64",
    "fuse.voxel_size=0.02",
    "simplify.ratio=0.3",
)
# Fusion in bricks, which are cached one by one; the result is byte-identical.
_IN_BRICKS = ("--set", "fuse.brick_size=0.3")
# Timeout, seconds: a run of this tiny scan is shorter even on a busy machine.
_PATIENCE = 300


@dataclass(frozen=True)
class UndisturbedRun:
    """A scan, the results of an undisturbed run, and its duration in seconds."""

    scan: Path
    expected: dict[str, bytes]
    seconds: float


def prepare_run(folder: Path) -> UndisturbedRun:
    """Make the scan, and run it once undisturbed.

    Raises
    ------
    AssertionError
        If this run fails.
    """
    scan = folder / "scan"
    scan.mkdir(parents=True)
    _write_scan(scan)
    started = time.monotonic()
    code, message = _finish(_start(scan, folder / "whole"))
    seconds = time.monotonic() - started
    assert code == 0, message
    return UndisturbedRun(scan, _read_results(folder / "whole"), seconds)


def run_case(seed: int, ready: UndisturbedRun, folder: Path) -> Verdict:
    """Run the case of a seed in an empty folder."""
    draw = random.Random(seed)
    name = draw.choice(("killed", *_CASES))
    verdict = _CASES[name](draw, ready, folder)
    return Verdict(verdict.outcome, f"{name}: {verdict.message}")


def _run_killed(draw: random.Random, ready: UndisturbedRun, folder: Path) -> Verdict:
    words = draw.choice(((), _IN_BRICKS))

    def run() -> str:
        for _ in range(draw.choice((1, 1, 2, 3))):
            with _start(ready.scan, folder / "out", words=words) as process:
                time.sleep(ready.seconds * draw.uniform(0.2, 1.0))
                process.kill()
        _assert_no_partial_files(ready, folder / "out")
        return _assert_recovers(ready, folder / "out", words)

    return judge(run)


def _run_short_of_disk(draw: random.Random, ready: UndisturbedRun, folder: Path) -> Verdict:
    """Limit the size of files: writes fail half-way, as on a full disk."""
    most = draw.choice((0, 100, 3000, 10_000, 30_000, 100_000))
    words = draw.choice(((), _IN_BRICKS))

    def run() -> str:
        code, message = _finish(_start(ready.scan, folder / "out", lambda: _limit_files(most), words))
        assert code in (0, 1, 3), f"exit code {code}: {message}"
        assert "Traceback" not in message, message
        assert "bug in scanloom" not in message, message
        assert code == 0 or message.strip(), "the run failed without a message"
        _assert_no_partial_files(ready, folder / "out")
        return f"{most} bytes, exit code {code}, {_assert_recovers(ready, folder / 'out', words)}"

    return judge(run)


def _run_on_full_disk(draw: random.Random, ready: UndisturbedRun, folder: Path) -> Verdict:
    """Run on a disk of some kilobytes; the case is skipped if none can be mounted."""
    disk = folder / "disk"
    disk.mkdir()
    size = draw.choice((16, 64, 200, 400))
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(disk)]
    mounted = shutil.which("mount") and subprocess.run(command, capture_output=True, check=False)
    if not mounted or mounted.returncode != 0:
        return Verdict(SKIPPED, "no disk can be mounted here")
    try:

        def run() -> str:
            code, message = _finish(_start(ready.scan, disk / "out"))
            assert code in (0, 1, 3), f"exit code {code}: {message}"
            assert "Traceback" not in message, message
            assert "bug in scanloom" not in message, message
            _assert_no_partial_files(ready, disk / "out")
            shutil.move(disk / "out", folder / "out") if (disk / "out").exists() else None
            return f"{size} kB, exit code {code}, {_assert_recovers(ready, folder / 'out')}"

        return judge(run)
    finally:
        subprocess.run(["umount", str(disk)], check=False)


def _run_two_at_once(draw: random.Random, ready: UndisturbedRun, folder: Path) -> Verdict:
    def run() -> str:
        first = _start(ready.scan, folder / "out")
        time.sleep(ready.seconds * draw.uniform(0, 0.9))
        second = _start(ready.scan, folder / "out")
        if draw.random() < 0.3:
            time.sleep(ready.seconds * draw.uniform(0, 0.9))
            first.kill()
        ends = [_finish(process) for process in (first, second)]
        for code, message in ends:
            assert code in (0, 3, -signal.SIGKILL), f"exit code {code}: {message}"
            assert "Traceback" not in message, message
            assert "bug in scanloom" not in message, message
        return f"exit codes {[code for code, _ in ends]}, {_assert_recovers(ready, folder / 'out')}"

    return judge(run)


def _run_read_only(draw: random.Random, ready: UndisturbedRun, folder: Path) -> Verdict:
    """Make a folder read-only; the case is skipped for the superuser."""
    if os.geteuid() == 0:
        return Verdict(SKIPPED, "the superuser may write to folders that are read-only")

    def run() -> str:
        out = folder / "out"
        code, message = _finish(_start(ready.scan, out))
        assert code == 0, message
        locked = draw.choice([path for path in (out, *out.rglob("*")) if path.is_dir()])
        locked.chmod(0o555)
        try:
            code, message = _finish(_start(ready.scan, out, words=("--set", "simplify.ratio=0.2")))
        finally:
            locked.chmod(0o755)
        assert code in (0, 1, 3), f"exit code {code}: {message}"
        assert "Traceback" not in message, message
        assert "bug in scanloom" not in message, message
        return f"{locked.name}, exit code {code}, {_assert_recovers(ready, out)}"

    return judge(run)


_CASES: dict[str, Callable[[random.Random, UndisturbedRun, Path], Verdict]] = {
    "killed": _run_killed,
    "short of disk": _run_short_of_disk,
    "full disk": _run_on_full_disk,
    "two at once": _run_two_at_once,
    "read-only": _run_read_only,
}


def _write_scan(folder: Path) -> None:
    """Write two coloured frames of a wavy surface."""
    frames = []
    v, u = np.mgrid[0 : _CAMERA.height, 0 : _CAMERA.width]
    for number, x in enumerate((-0.02, 0.02)):
        depth = 1.0 + 0.05 * np.sin(u / 9 + 40 * x) * np.cos(v / 7)
        color = np.stack([4 * u, 5 * v, 0 * u + 90], -1).astype(np.uint8)
        files = {kind: folder / f"{kind}-{number}.png" for kind in ("color", "depth")}
        cv2.imwrite(str(files["depth"]), np.rint(depth * 1000).astype(np.uint16))
        cv2.imwrite(str(files["color"]), color)
        pose = np.eye(4)
        pose[0, 3] = x
        frames.append(
            Frame(str(number), _CAMERA, files["color"], depth=files["depth"], world_from_camera=pose)
        )
    write_scan_json(folder, frames)


def _start(
    scan: Path, out: Path, before: Callable[[], None] | None = None, words: tuple[str, ...] = ()
) -> subprocess.Popen[str]:
    settings = [word for setting in _SMALL for word in ("--set", setting)]
    command = [
        sys.executable,
        "-m",
        "scanloom.cli.app",
        "run",
        str(scan),
        "-o",
        str(out),
        "--quiet",
        *settings,
        *words,
    ]
    return subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=before
    )


def _finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for the end; return the exit code and stderr."""
    try:
        _, message = process.communicate(timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise AssertionError(f"a run took more than {_PATIENCE} s") from None
    return process.returncode, message


def _limit_files(most: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def _read_results(out: Path) -> dict[str, bytes]:
    """Read the results by name, without the cache, and without the report, which contains times."""
    files = [path for path in out.rglob("*") if path.is_file() and out / "cache" not in path.parents]
    return {
        str(path.relative_to(out)): path.read_bytes() for path in files if not path.name.startswith("report.")
    }


def _assert_no_partial_files(ready: UndisturbedRun, out: Path) -> None:
    left = _read_results(out) if out.exists() else {}
    wrong = [
        name
        for name, content in left.items()
        if not name.endswith(".part") and content != ready.expected.get(name)
    ]
    assert not wrong, f"a half-written result: {wrong}"


def _assert_recovers(ready: UndisturbedRun, out: Path, words: tuple[str, ...] = ()) -> str:
    """Run again undisturbed, and compare the results."""
    code, message = _finish(_start(ready.scan, out, words=words))
    assert code == 0, f"the next run ended with {code}: {message}"
    found = _read_results(out)
    assert found.keys() == ready.expected.keys(), f"other files: {found.keys() ^ ready.expected.keys()}"
    other = [name for name, content in found.items() if content != ready.expected[name]]
    assert not other, f"other bytes: {other}"
    return "the next run has the same bytes"
