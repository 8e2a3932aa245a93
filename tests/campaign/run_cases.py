"""Whole runs that something happens to: they are killed, out of disk, or two at once in one folder.

Whatever happened, the next run ends with the bytes of one that nothing happened to.
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
from tests.campaign.verdict import SKIPPED, Verdict, judged

_CAMERA = Camera(64, 48, 55.0, 55.0, 31.5, 23.5)
# The smallest of everything, so that a run takes little more than the imports.
_SMALL = (
    "compare.samples=500",
    "report.viewpoints=1",
    "report.width=64",
    "fuse.voxel_size=0.02",
    "simplify.ratio=0.3",
)
# Space in bricks, which are kept one by one; what comes out is the same to the byte.
_IN_BRICKS = ("--set", "fuse.brick_size=0.3")
# No run of so small a scan takes so long, however busy the machine is.
_PATIENCE = 300


@dataclass(frozen=True)
class Bench:
    """A scan, what an undisturbed run makes of it, and how long that took, seconds."""

    scan: Path
    expected: dict[str, bytes]
    seconds: float


def bench(folder: Path) -> Bench:
    """Make the scan, and run it once with nothing in the way.

    Raises
    ------
    AssertionError
        If even that run fails.
    """
    scan = folder / "scan"
    scan.mkdir(parents=True)
    _write_scan(scan)
    started = time.monotonic()
    code, said = _finished(_start(scan, folder / "whole"))
    seconds = time.monotonic() - started
    assert code == 0, said
    return Bench(scan, _results(folder / "whole"), seconds)


def run_case(seed: int, ready: Bench, folder: Path) -> Verdict:
    """Run the case of a seed in an empty folder."""
    draw = random.Random(seed)
    name = draw.choice(("killed", *_CASES))
    verdict = _CASES[name](draw, ready, folder)
    return Verdict(verdict.outcome, f"{name}: {verdict.said}")


def _killed(draw: random.Random, ready: Bench, folder: Path) -> Verdict:
    words = draw.choice(((), _IN_BRICKS))

    def case() -> str:
        for _ in range(draw.choice((1, 1, 2, 3))):
            with _start(ready.scan, folder / "out", words=words) as process:
                time.sleep(ready.seconds * draw.uniform(0.2, 1.0))
                process.kill()
        _assert_no_half(ready, folder / "out")
        return _assert_recovers(ready, folder / "out", words)

    return judged(case)


def _short_of_disk(draw: random.Random, ready: Bench, folder: Path) -> Verdict:
    """No file can grow beyond a size: writes end half-way, as on a full disk."""
    most = draw.choice((0, 100, 3000, 10_000, 30_000, 100_000))
    words = draw.choice(((), _IN_BRICKS))

    def case() -> str:
        code, said = _finished(_start(ready.scan, folder / "out", lambda: _limit_files(most), words))
        assert code in (0, 1, 3), f"exit code {code}: {said}"
        assert "Traceback" not in said, said
        assert "bug in scanloom" not in said, said
        assert code == 0 or said.strip(), "it failed without a word"
        _assert_no_half(ready, folder / "out")
        return f"{most} bytes, exit code {code}, {_assert_recovers(ready, folder / 'out', words)}"

    return judged(case)


def _full_disk(draw: random.Random, ready: Bench, folder: Path) -> Verdict:
    """A disk of some kilobytes; where none can be mounted, that is said."""
    disk = folder / "disk"
    disk.mkdir()
    size = draw.choice((16, 64, 200, 400))
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(disk)]
    mounted = shutil.which("mount") and subprocess.run(command, capture_output=True, check=False)
    if not mounted or mounted.returncode != 0:
        return Verdict(SKIPPED, "no disk can be mounted here")
    try:

        def case() -> str:
            code, said = _finished(_start(ready.scan, disk / "out"))
            assert code in (0, 1, 3), f"exit code {code}: {said}"
            assert "Traceback" not in said, said
            assert "bug in scanloom" not in said, said
            _assert_no_half(ready, disk / "out")
            shutil.move(disk / "out", folder / "out") if (disk / "out").exists() else None
            return f"{size} kB, exit code {code}, {_assert_recovers(ready, folder / 'out')}"

        return judged(case)
    finally:
        subprocess.run(["umount", str(disk)], check=False)


def _two_at_once(draw: random.Random, ready: Bench, folder: Path) -> Verdict:
    def case() -> str:
        first = _start(ready.scan, folder / "out")
        time.sleep(ready.seconds * draw.uniform(0, 0.9))
        second = _start(ready.scan, folder / "out")
        if draw.random() < 0.3:
            time.sleep(ready.seconds * draw.uniform(0, 0.9))
            first.kill()
        ends = [_finished(process) for process in (first, second)]
        for code, said in ends:
            assert code in (0, 3, -signal.SIGKILL), f"exit code {code}: {said}"
            assert "Traceback" not in said, said
            assert "bug in scanloom" not in said, said
        return f"exit codes {[code for code, _ in ends]}, {_assert_recovers(ready, folder / 'out')}"

    return judged(case)


def _read_only(draw: random.Random, ready: Bench, folder: Path) -> Verdict:
    """Whoever may write everywhere does not meet this."""
    if os.geteuid() == 0:
        return Verdict(SKIPPED, "the superuser may write to folders that are read-only")

    def case() -> str:
        out = folder / "out"
        code, said = _finished(_start(ready.scan, out))
        assert code == 0, said
        locked = draw.choice([path for path in (out, *out.rglob("*")) if path.is_dir()])
        locked.chmod(0o555)
        try:
            code, said = _finished(_start(ready.scan, out, words=("--set", "simplify.ratio=0.2")))
        finally:
            locked.chmod(0o755)
        assert code in (0, 1, 3), f"exit code {code}: {said}"
        assert "Traceback" not in said, said
        assert "bug in scanloom" not in said, said
        return f"{locked.name}, exit code {code}, {_assert_recovers(ready, out)}"

    return judged(case)


_CASES: dict[str, Callable[[random.Random, Bench, Path], Verdict]] = {
    "killed": _killed,
    "short of disk": _short_of_disk,
    "full disk": _full_disk,
    "two at once": _two_at_once,
    "read-only": _read_only,
}


def _write_scan(folder: Path) -> None:
    """Two frames of hills, coloured."""
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


def _finished(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Return the exit code and what was said on stderr."""
    try:
        _, said = process.communicate(timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise AssertionError(f"a run took more than {_PATIENCE} s") from None
    return process.returncode, said


def _limit_files(most: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def _results(out: Path) -> dict[str, bytes]:
    """Return the results by name; the cache is not among them, nor the report, which tells of seconds."""
    files = [path for path in out.rglob("*") if path.is_file() and out / "cache" not in path.parents]
    return {
        str(path.relative_to(out)): path.read_bytes() for path in files if not path.name.startswith("report.")
    }


def _assert_no_half(ready: Bench, out: Path) -> None:
    left = _results(out) if out.exists() else {}
    wrong = [
        name
        for name, content in left.items()
        if not name.endswith(".part") and content != ready.expected.get(name)
    ]
    assert not wrong, f"a half-written result: {wrong}"


def _assert_recovers(ready: Bench, out: Path, words: tuple[str, ...] = ()) -> str:
    """Run once more, undisturbed, and compare."""
    code, said = _finished(_start(ready.scan, out, words=words))
    assert code == 0, f"the next run ended with {code}: {said}"
    found = _results(out)
    assert found.keys() == ready.expected.keys(), f"other files: {found.keys() ^ ready.expected.keys()}"
    other = [name for name, content in found.items() if content != ready.expected[name]]
    assert not other, f"other bytes: {other}"
    return "the next run has the same bytes"
