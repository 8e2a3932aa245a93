"""The first command of a newcomer, `make demo`, says what it does for minutes."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_the_demo_prints_its_steps_and_what_pip_does(tmp_path: Path) -> None:
    # Without the variables of a make that runs this test.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}

    def planned(target: str) -> list[str]:
        words = ["make", "--dry-run", "--always-make", f"VENV={tmp_path}", target]
        ran = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
        return ran.stdout.splitlines()

    lines = planned("demo")
    steps = [line for line in lines if line.startswith("echo ")]
    assert [step[6:].split()[0] for step in steps[:2]] == ["Step", "minutes,"]
    assert any("Installing the Python packages" in step for step in steps)
    assert any("Compiling the kernels" in step for step in steps)
    installed = [line for line in lines if "pip install" in line]
    assert len(installed) == 2
    assert not any("--quiet" in line for line in installed)
    assert all("--quiet" in line for line in planned(f"{tmp_path}/.ready") if "pip install" in line)
