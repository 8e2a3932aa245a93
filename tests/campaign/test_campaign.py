"""The campaign itself: a few dozen cases of each kind are held, and a failure is found, kept and repeated."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
# Its modules are imported by their full names, and those of tests/made by their own.
_PATHS = os.pathsep.join((str(ROOT), str(ROOT / "tests" / "made")))


@dataclass(frozen=True)
class Ended:
    """How the command of the campaign ended."""

    returncode: int
    stdout: str


@pytest.fixture
def campaign(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Return the command of the campaign, which runs here; its cases have processes of their own."""
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.setenv("PYTHONPATH", _PATHS)
    monkeypatch.chdir(ROOT)
    from tests.campaign.__main__ import main

    def run(*words: object) -> Ended:
        code = main([str(word) for word in words])
        return Ended(code, capsys.readouterr().out)

    return run


def by_itself(*words: object) -> Ended:
    """Run the command of the campaign as people do."""
    command = [sys.executable, "-m", "tests.campaign", *map(str, words)]
    env = {**os.environ, "PYTHONPATH": _PATHS}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    return Ended(done.returncode, done.stdout + done.stderr)


def counts(ended: Ended, kind: str) -> list[int]:
    """Cases, accepted, refused, skipped and failed of a kind, from the table."""
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith(kind) and ":" not in line]
    return [int(word) for word in line.split()[1:]]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "cases"), [("readers", 400), ("runs", 2), ("kernels", 24), ("fusion", 24)])
def test_some_cases_of_each_kind_end_well(
    campaign: Callable[..., Ended], tmp_path: Path, kind: str, cases: int
) -> None:
    run = by_itself if kind == "runs" else campaign
    ended = run("--failures", tmp_path, "--only", kind, "--cases", cases, "--seed", 2)
    assert ended.returncode == 0, ended.stdout
    held, accepted, refused, skipped, failed = counts(ended, kind)
    assert held == cases
    assert accepted + refused + skipped == held
    assert failed == 0
    assert accepted > 0
    if kind == "readers":
        assert refused > accepted > 40


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("raise IndexError('lost')", "IndexError: lost"),
        ("os.abort()", "SIGABRT"),
        ("bytearray(1 << 40)", "MemoryError"),
        ("sys.exit(5)", "SystemExit: 5"),
    ],
)
def test_a_failure_of_any_kind_is_told_kept_and_repeated(
    campaign: Callable[..., Ended], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, wrong: str, said: str
) -> None:
    # What Python runs at its start stands in for a reader's own fault.
    (tmp_path / "sitecustomize.py").write_text(
        f"import os, sys\nimport scanloom.stages.surface.mesh_files as files\ndef fault(path):\n    {wrong}\n"
        "files.read_mesh = fault\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path), _PATHS)))
    words = ["--failures", tmp_path / "kept"]
    ended = campaign(*words, "--only", "readers", "--cases", 8)
    assert ended.returncode == 1, ended.stdout
    kept = sorted((tmp_path / "kept").iterdir())
    assert len(kept) == counts(ended, "readers")[-1] > 0
    assert kept[0].name in ended.stdout

    again = campaign(*words, "--again", kept[0])
    assert again.returncode == 1, again.stdout
    assert said in again.stdout


@pytest.mark.parametrize(
    ("triangles", "count", "said"),
    [
        ([[0, 1, 2], [0, 2, 1]], 3, None),
        ([[0, 1, 2], [2, 1, 3]], 4, None),
        ([[0, 1, 2], [1, 2, 3]], 4, "look to different sides"),
        ([[0, 1, 2], [0, 3, 4]], 5, "joins two fans"),
        ([[0, 1, 2], [1, 0, 3], [0, 1, 4]], 5, "look to different sides"),
        ([[0, 1, 2]], 4, "without a triangle"),
        ([[0, 1, 1]], 2, "a vertex twice"),
        ([[0, 1, 3]], 3, "out of range"),
    ],
)
def test_what_is_no_manifold_is_noticed(
    monkeypatch: pytest.MonkeyPatch, triangles: list[list[int]], count: int, said: str | None
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign.kernel_rules import assert_manifold

    table = np.array(triangles, np.int32)
    if said is None:
        assert_manifold(table, count)
        return
    with pytest.raises(AssertionError, match=said):
        assert_manifold(table, count)


def test_the_same_seed_gives_the_same_damage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign.damage import damaged

    for data in (
        b'{"a": [1, 2, 3], "b": {"c": 0.5}}',
        b"ply\nformat ascii 1.0\nend_header\n1 2 3\n",
        b"PK\x03\x04",
    ):
        some = [damaged(data, random.Random(seed)) for seed in range(50)]
        assert some == [damaged(data, random.Random(seed)) for seed in range(50)]
        assert len(set(some)) > 20


def test_damage_upon_damage_makes_no_file_of_a_gigabyte(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign import damage

    monkeypatch.setattr(damage, "_once", lambda data, _: 3 * data)
    assert all(len(damage.damaged(bytes(1 << 25), random.Random(seed))) <= 1 << 26 for seed in range(5))
