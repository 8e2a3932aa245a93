"""A killed run leaves complete results or none, and the next run gives the same bytes."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest

from scanloom.pipeline.cache.store import Cache

pytestmark = pytest.mark.slow

_EVERYWHERE = Path(__file__).with_name("kill_everywhere.py")


def read_results(out: Path) -> dict[str, bytes]:
    """Read all files of an output folder except the cache, by name."""
    files = [path for path in out.rglob("*") if path.is_file() and out / "cache" not in path.parents]
    return {str(path.relative_to(out)): path.read_bytes() for path in files}


def test_killed_at_every_step(toy: ModuleType, tmp_path: Path):
    scan = toy.write_scan(tmp_path / "scan", frames=2)
    (tmp_path / "work").mkdir()
    done = subprocess.run(
        [sys.executable, _EVERYWHERE, scan, tmp_path / "work", "1"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100


def test_killed_at_random_moments(toy: ModuleType, tmp_path: Path):
    scan = toy.write_scan(tmp_path / "scan", frames=300)
    started = time.perf_counter()
    command = [sys.executable, toy.__file__, str(scan)]
    subprocess.run([*command, str(tmp_path / "whole")], check=True)
    whole = time.perf_counter() - started
    expected = read_results(tmp_path / "whole")

    out = tmp_path / "out"
    draw = random.Random(3)
    killed = 0
    for _ in range(8):
        with subprocess.Popen([*command, str(out)]) as process:
            time.sleep(whole * draw.uniform(0.3, 0.95))
            process.kill()
        killed += process.returncode == -signal.SIGKILL
        left = read_results(out) if out.exists() else {}
        assert {name: expected[name] for name in left if not name.endswith(".part")}.items() <= left.items()
        assert all(entry.problem is None for entry in Cache(out / "cache").verify())
    assert killed > 3

    toy.run(scan, out)
    assert read_results(out) == expected
    assert not list((out / "cache" / "drafts").iterdir())


def test_interrupted_run_cleans_up(toy: ModuleType, tmp_path: Path):
    scan = toy.write_scan(tmp_path / "scan", frames=3000)
    out = tmp_path / "out"
    with subprocess.Popen(
        [sys.executable, toy.__file__, str(scan), str(out)], stderr=subprocess.PIPE
    ) as process:
        deadline = time.monotonic() + 30
        while not list(out.glob("cache/drafts/mix-*/each")) and time.monotonic() < deadline:
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate()
    assert b"KeyboardInterrupt" in errors
    assert not list((out / "cache" / "drafts").iterdir())
    assert Cache(out / "cache").ls() == []
