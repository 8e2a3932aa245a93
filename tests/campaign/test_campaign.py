"""The campaign itself: some cases of each kind pass, and a failure is found, stored and repeated."""

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
# Modules of the campaign are imported by full names, and modules of tests/made by their own names.
_PATHS = os.pathsep.join((str(ROOT), str(ROOT / "tests" / "made")))


@dataclass(frozen=True)
class CommandResult:
    """Exit code and output of the command."""

    returncode: int
    stdout: str


@pytest.fixture
def campaign(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., CommandResult]:
    """Return the command of the campaign, run in this process."""
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.setenv("PYTHONPATH", _PATHS)
    monkeypatch.chdir(ROOT)
    from tests.campaign.__main__ import main

    def run(*words: object) -> CommandResult:
        code = main([str(word) for word in words])
        return CommandResult(code, capsys.readouterr().out)

    return run


def run_in_subprocess(*words: object) -> CommandResult:
    """Run the command of the campaign as a user does."""
    command = [sys.executable, "-m", "tests.campaign", *map(str, words)]
    env = {**os.environ, "PYTHONPATH": _PATHS}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    return CommandResult(done.returncode, done.stdout + done.stderr)


def parse_counts(ended: CommandResult, kind: str) -> list[int]:
    """Parse the counts of a kind from the table: cases, accepted, refused, skipped and failed."""
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith(kind) and ":" not in line]
    return [int(word) for word in line.split()[1:]]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "cases"), [("readers", 400), ("runs", 2), ("kernels", 24), ("fusion", 24)])
def test_cases_of_each_kind_pass(
    campaign: Callable[..., CommandResult], tmp_path: Path, kind: str, cases: int
) -> None:
    run = run_in_subprocess if kind == "runs" else campaign
    ended = run("--failures", tmp_path, "--only", kind, "--cases", cases, "--seed", 2)
    assert ended.returncode == 0, ended.stdout
    held, accepted, refused, skipped, failed = parse_counts(ended, kind)
    assert held == cases
    assert accepted + refused + skipped == held
    assert failed == 0
    assert accepted > 0
    if kind == "readers":
        assert refused > accepted > 40


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("raise IndexError('lost')", "IndexError: lost"),
        ("os.abort()", "SIGABRT"),
        ("bytearray(1 << 40)", "MemoryError"),
        ("sys.exit(5)", "SystemExit: 5"),
    ],
)
def test_a_failure_of_any_kind_is_reported_stored_and_repeated(
    campaign: Callable[..., CommandResult],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    wrong: str,
    message: str,
) -> None:
    # Python runs this file at its start; the patched function simulates a bug of a reader.
    (tmp_path / "sitecustomize.py").write_text(
        f"import os, sys\nimport scanloom.stages.surface.mesh_files as files\ndef fault(path):\n    {wrong}\n"
        "files.read_mesh = fault\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path), _PATHS)))
    words = ["--failures", tmp_path / "kept"]
    ended = campaign(*words, "--only", "readers", "--cases", 8)
    assert ended.returncode == 1, ended.stdout
    kept = sorted((tmp_path / "kept").iterdir())
    assert len(kept) == parse_counts(ended, "readers")[-1] > 0
    assert kept[0].name in ended.stdout

    again = campaign(*words, "--again", kept[0])
    assert again.returncode == 1, again.stdout
    assert message in again.stdout


@pytest.mark.parametrize(
    ("triangles", "count", "message"),
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
def test_non_manifold_triangles_are_detected(
    monkeypatch: pytest.MonkeyPatch, triangles: list[list[int]], count: int, message: str | None
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign.kernel_rules import assert_manifold

    table = np.array(triangles, np.int32)
    if message is None:
        assert_manifold(table, count)
        return
    with pytest.raises(AssertionError, match=message):
        assert_manifold(table, count)


def test_the_same_seed_gives_the_same_damage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign.damage import damage_file

    for data in (
        b'{"a": [1, 2, 3], "b": {"c": 0.5}}',
        b"ply\nformat ascii 1.0\nend_header\n1 2 3\n",
        b"PK\x03\x04",
    ):
        some = [damage_file(data, random.Random(seed)) for seed in range(50)]
        assert some == [damage_file(data, random.Random(seed)) for seed in range(50)]
        assert len(set(some)) > 20


def test_repeated_damage_does_not_grow_a_file_to_a_gigabyte(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign import damage

    monkeypatch.setattr(damage, "_damage_once", lambda data, _: 3 * data)
    assert all(len(damage.damage_file(bytes(1 << 25), random.Random(seed))) <= 1 << 26 for seed in range(5))
