"""Other platforms: an emulation of Windows, and consistency of wheel and image recipes with the project."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CRATE = tomllib.loads((ROOT / "kernels" / "Cargo.toml").read_text(encoding="utf-8"))["package"]
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
WORKFLOW = ROOT / ".github" / "workflows" / "wheels.yml"

# The emulation patches functions that pathlib and shutil bind differently in other Python versions.
simulated = pytest.mark.skipif(
    sys.platform != "linux" or not (3, 11) <= sys.version_info < (3, 14), reason="simulates Windows on Linux"
)

IMPORT_ALL = """
from pretend_windows import MISSING_MODULES, pretend
pretend()
import importlib, sys
from pathlib import Path
rooms = ("stages", "pipeline", "cli")
files = [path for room in rooms for path in Path(room).rglob("*.py") if "node_modules" not in path.parts]
others = {"scanloom.pipeline.cache.posix"}
names = {".".join(("scanloom", *path.with_suffix("").parts)).removesuffix(".__init__") for path in files}
names -= others
for name in sorted(names):
    importlib.import_module(name)
assert all(sys.modules[name] is None for name in MISSING_MODULES)
assert "scanloom.pipeline.cache.windows" in sys.modules and "scanloom.pipeline.cache.posix" not in sys.modules
print(len(names))
from scanloom.stages.inspecting.machine_report import describe_machine
told = describe_machine()
assert told["memory_total_bytes"] == 8 << 30 and told["memory_available_bytes"] == 5 << 30
notes = told["platform_notes"]
assert ["Linux" in notes[0], "260 characters" in notes[1]] == [True, True], told
"""


def run_as_windows(*words: str) -> str:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "made")))}
    done = subprocess.run(
        [sys.executable, *words], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@simulated
@pytest.mark.slow
def test_every_module_imports_without_unix_modules() -> None:
    assert int(run_as_windows("-c", IMPORT_ALL)) > 300


@simulated
@pytest.mark.slow
def test_locks_and_the_cache_work_on_windows() -> None:
    report = run_as_windows(
        *("-m", "pytest", "-p", "pretend_windows", "-q", "tests/pipeline/test_locks.py"),
        *(f"tests/pipeline/test_{name}.py" for name in ("cache", "cache_shared", "cache_places")),
        "tests/stages/files/test_atomic_folders.py",
    )
    passed = re.search(r"(\d+) passed", report)
    assert passed is not None
    assert int(passed[1]) > 100


@simulated
@pytest.mark.slow
def test_killed_runs_leave_no_partial_results_on_windows(tmp_path: Path) -> None:
    sys.path.insert(0, str(ROOT / "tests" / "pipeline"))
    try:
        import toy
    finally:
        sys.path.pop(0)
    scan = toy.write_scan(tmp_path / "scan", frames=2)
    (tmp_path / "work").mkdir()
    every = 25
    kills = run_as_windows(
        "tests/pipeline/kill_everywhere.py", str(scan), str(tmp_path / "work"), str(every), "windows"
    )
    assert int(kills) > 8


def get_newest_python() -> int:
    """Get the minor version of the newest Python that the project supports."""
    [_, limit] = re.findall(r"3\.(\d+)", PROJECT["requires-python"])
    return int(limit) - 1


def test_the_image_fits_the_project() -> None:
    pythons = {int(minor) for minor in re.findall(r"^FROM python:3\.(\d+)-slim", DOCKERFILE, re.MULTILINE)}
    assert len(pythons) == 1
    assert 10 <= pythons.pop() <= get_newest_python()
    [rust] = re.findall(r"^FROM rust:(\d+\.\d+)-slim", DOCKERFILE, re.MULTILINE)
    assert tuple(map(int, rust.split("."))) >= tuple(map(int, CRATE["rust-version"].split(".")))
    assert 'ENTRYPOINT ["scanloom"]' in DOCKERFILE
    # The last stage runs as a separate user.
    last = DOCKERFILE.rpartition("FROM ")[2]
    assert re.search(r"^USER (?!root)", last, re.MULTILINE)
    assert "cargo" not in last


def test_the_image_contains_the_sources_of_the_wheel() -> None:
    needed = {"pyproject.toml", "README.md", "LICENSE", "packaging", "kernels", "scanloom"}
    needed |= {"cli", "pipeline", "stages"}
    copied = re.findall(r"^COPY (?!--from)(.*) \S+$", DOCKERFILE, re.MULTILINE)
    assert set(" ".join(copied).split()) == needed
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    assert ignored[0] == "*", "nothing else gets into the image by chance"
    assert {line[1:].rstrip("/") for line in ignored if line.startswith("!")} == needed


def load_workflow() -> dict[str, Any]:
    loaded = yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))
    assert isinstance(loaded, dict)
    return loaded


def test_wheels_are_built_and_tested_on_every_system() -> None:
    jobs = load_workflow()["jobs"]
    built = jobs["wheel"]["strategy"]["matrix"]["include"]
    assert {one["runner"].split("-")[0] for one in built} == {"ubuntu", "windows", "macos"}
    tried = jobs["try"]["strategy"]["matrix"]
    pythons = {int(version.split(".")[1]) for version in tried["python"]}
    assert min(pythons) == 10
    assert max(pythons) == get_newest_python()
    assert {one.split("-")[0] for one in tried["runner"]} == {"ubuntu", "windows", "macos"}
    text = WORKFLOW.read_text(encoding="utf-8")
    assert "scanloom run samples/rgbd" in text
    # Actions are pinned by version, and the token is read-only.
    assert all(re.search(r"@v\d", used) for used in re.findall(r"uses: (\S+)", text))
    assert load_workflow()["permissions"] == {"contents": "read"}


def test_the_wheels_rust_is_new_enough() -> None:
    [rust] = set(re.findall(r"rust-toolchain: \"?(\d+\.\d+)", WORKFLOW.read_text(encoding="utf-8")))
    assert rust == CRATE["rust-version"]


def test_the_page_lists_the_tested_platforms() -> None:
    page = (ROOT / "docs" / "platforms.md").read_text(encoding="utf-8")
    assert PROJECT["requires-python"] in page
    assert "not tried on hardware" in page
