"""The wheel contains one package with the kernels and the command, and nothing else."""

import base64
import csv
import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from clashing_project import CODE, write_clashing_project
from small_scans import write_small_scan

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
    assert "scanloom/stages/files/ktx2_codec.mjs" in names

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


@pytest.mark.thorough
def test_the_wheel_is_installed_into_an_empty_environment_without_rust(wheel: Path, tmp_path: Path) -> None:
    """Install as a user does, with all dependencies from the index, and read a scan."""
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "venv")], check=True)
    scripts = tmp_path / "venv" / ("Scripts" if os.name == "nt" else "bin")
    # Neither compilers nor this checkout can be found.
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "CARGO"))
    }
    environment["PATH"] = os.pathsep.join([str(scripts), os.defpath])
    assert shutil.which("cargo", path=environment["PATH"]) is None
    words = ["--disable-pip-version-check", "--quiet", "--only-binary", ":all:", "--no-compile", str(wheel)]
    subprocess.run(
        [scripts / "python", "-m", "pip", "install", *words], env=environment, check=True, timeout=1800
    )

    def run(*arguments: object) -> str:
        done = subprocess.run(
            [scripts / "scanloom", *map(str, arguments)],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert run("--version").startswith(f"scanloom {wheel.name.split('-')[1]}\n")
    assert "plain-rgbd" in run("inspect", ROOT / "samples" / "rgbd")
    run("run", write_small_scan(tmp_path / "scan"), "-o", tmp_path / "out")
    assert (tmp_path / "out" / "textured.glb").stat().st_size > 1000
