"""mypy reports exactly the errors that calls.py expects."""

import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CALLS = Path(__file__).with_name("calls.py")


@pytest.fixture(scope="module", autouse=True)
def link_packages() -> None:
    """Link the packages for mypy, like `make mypy`."""
    folder = ROOT / "build" / "types" / "scanloom"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("stages", "pipeline", "cli"):
        with suppress(FileExistsError):
            (folder / name).symlink_to(Path("..", "..", "..", name))


def test_mypy_accepts_right_calls_and_refuses_wrong_ones():
    lines = CALLS.read_text(encoding="utf-8").splitlines()
    marks = {number: re.search(r"# error: ([\w-]+)$", line) for number, line in enumerate(lines, 1)}
    expected = {(number, mark[1]) for number, mark in marks.items() if mark}
    # The cache is shared with `make lint`, whose options are the same; without a cache mypy takes much
    # longer.
    command = [sys.executable, "-m", "mypy", "--no-error-summary", "--no-pretty", str(CALLS)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    said = re.findall(r"^(\S+?):(\d+): error: .*\[([\w-]+)\]$", done.stdout, re.MULTILINE)
    assert not done.stderr
    assert {name for name, _, _ in said} == {str(CALLS.relative_to(ROOT))}, done.stdout
    found = {(int(number), code) for _, number, code in said}
    assert found == expected, done.stdout
