"""What a user installs: three packages, the kernels and the command, and nothing else."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel_names(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "maturin", "build", "--release", "--quiet", "--out", str(out)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert result.returncode == 0, result.stderr
    (wheel,) = out.glob("*.whl")
    return zipfile.ZipFile(wheel).namelist()


def test_holds_only_the_three_packages(wheel_names: list[str]):
    tops = {name.split("/")[0] for name in wheel_names}
    assert {top for top in tops if not top.endswith((".dist-info", ".libs"))} == {"stages", "pipeline", "cli"}


def test_holds_types_kernels_and_command(wheel_names: list[str]):
    assert {"stages/py.typed", "stages/_kernels.pyi"} <= set(wheel_names)
    assert any(name.startswith("stages/_kernels.") and name.endswith((".so", ".pyd")) for name in wheel_names)
    assert any(name.endswith("entry_points.txt") for name in wheel_names)
    assert any(name.endswith("LICENSE") for name in wheel_names)


def test_every_source_module_is_in_it(wheel_names: list[str]):
    sources = {
        p.relative_to(ROOT).as_posix()
        for room in ("stages", "pipeline", "cli")
        for p in (ROOT / room).rglob("*.py")
    }
    assert sources <= set(wheel_names)
