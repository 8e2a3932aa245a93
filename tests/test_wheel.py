"""The wheel contains one package with the kernels and the command, and nothing else."""

import base64
import csv
import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from clashing_project import CODE, write_clashing_project

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("stages", "pipeline", "cli")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel once; two builds at the same time would use the same folder."""
    folder = tmp_path_factory.mktemp("wheel")
    words = ["--no-build-isolation", "--no-deps", "--disable-pip-version-check", "--quiet", "--wheel-dir"]
    command = [sys.executable, "-m", "pip", "wheel", *words, str(folder), str(ROOT)]
    environment = {
        **os.environ,
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
    }
    result = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=900, check=False
    )
    assert result.returncode == 0, result.stderr
    (path,) = folder.glob("*.whl")
    return path


def test_the_wheel_holds_one_package(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())

    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"scanloom"}
    assert {name.split("/")[1] for name in names if name.startswith("scanloom/")} == {
        "__init__.py",
        "py.typed",
        *PACKAGES,
    }

    assert "scanloom/stages/_kernels.pyi" in names
    kernels = [name for name in names if name.startswith("scanloom/stages/_kernels.")]
    assert any(name.endswith((".so", ".pyd")) for name in kernels)
    assert any(name.endswith("entry_points.txt") for name in names)
    assert any(name.endswith("LICENSE") for name in names)

    sources = {p.relative_to(ROOT).as_posix() for one in PACKAGES for p in (ROOT / one).rglob("*.py")}
    assert {f"scanloom/{source}" for source in sources} <= names

    page = ROOT / "pipeline" / "report" / "page"
    shown = {page / "library.js", page / "LICENSES.txt", *(page / "tiles").iterdir()}
    assert {f"scanloom/{path.relative_to(ROOT).as_posix()}" for path in shown} <= names
    assert not any("node_modules" in name for name in names)


def test_the_record_of_the_wheel_matches_its_files(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (record,) = [name for name in archive.namelist() if name.endswith(".dist-info/RECORD")]
        rows = list(csv.reader(archive.read(record).decode().splitlines()))
        assert sorted(name for name, *_ in rows) == sorted(archive.namelist())
        for name, hashed, size in rows:
            if name != record:
                content = archive.read(name)
                digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
                assert (hashed, int(size)) == (f"sha256={digest}", len(content)), name


def test_the_installed_wheel_works_next_to_modules_of_the_same_names(wheel: Path, tmp_path: Path) -> None:
    installed = tmp_path / "installed"
    words = ["--no-deps", "--disable-pip-version-check", "--quiet", "--target", str(installed), str(wheel)]
    subprocess.run([sys.executable, "-m", "pip", "install", *words], check=True)
    folder = write_clashing_project(tmp_path / "project")

    environment = {**os.environ, "PYTHONPATH": str(installed)}
    done = subprocess.run(
        [sys.executable, folder / CODE],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == str(installed / "scanloom" / "__init__.py")

    environment["PYTHONPATH"] = os.pathsep.join([".", str(installed)])
    script = [installed / "bin" / "scanloom", "check", "mesh.ply", "--json"]
    done = subprocess.run(
        [sys.executable, *script], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
