"""What a user installs: three packages, the kernels and the command, and nothing else."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]


def test_the_wheel_holds_what_a_user_installs(tmp_path: Path) -> None:
    # One test: two at the same time would build in the same folder.
    command = [sys.executable, "-m", "maturin", "build", "--release", "--quiet", "--out", str(tmp_path)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert result.returncode == 0, result.stderr
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())

    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith((".dist-info", ".libs"))} == {"stages", "pipeline", "cli"}

    assert {"stages/py.typed", "stages/_kernels.pyi"} <= names
    assert any(name.startswith("stages/_kernels.") and name.endswith((".so", ".pyd")) for name in names)
    assert any(name.endswith("entry_points.txt") for name in names)
    assert any(name.endswith("LICENSE") for name in names)

    rooms = ("stages", "pipeline", "cli")
    sources = {p.relative_to(ROOT).as_posix() for room in rooms for p in (ROOT / room).rglob("*.py")}
    assert sources <= names

    page = ROOT / "stages" / "picturing" / "page"
    shown = {page / "library.js", page / "LICENSES.txt", *(page / "tiles").iterdir()}
    assert {path.relative_to(ROOT).as_posix() for path in shown} <= names
    assert not any("node_modules" in name for name in names)
