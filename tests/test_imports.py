"""Imports go one way, cli → pipeline → stages → stages._kernels, and only what is declared is imported."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("stages", "pipeline", "cli")
MODULES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
# What a distribution is imported as, where that is not its own name.
IMPORTED_AS = {
    "backports.zstd": "backports",
    "opencv-contrib-python-headless": "cv2",
    "openexr": "OpenEXR",
    "pillow": "PIL",
    "pyyaml": "yaml",
    "libusb-package": "libusb_package",
}
# In the standard library of some of the Pythons that are supported.
LATER = {"compression", "tomllib"}
# Type checkers bring it themselves; no program imports it.
TYPES_ONLY = {"typing_extensions"}
HEAVY = ("open3d", "cv2", "OpenEXR", "scipy", "trimesh")


def imported(path: Path) -> set[str]:
    """First names of everything a module imports, wherever in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add((node.module or "").split(".")[0])
    return names


def declared() -> set[str]:
    """Import names of the dependencies that every installation has."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.match(r"[\w.-]+", line)[0].lower() for line in project["dependencies"]]
    return {IMPORTED_AS.get(name, name.replace("-", "_")) for name in names}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_one_way_and_are_declared(path):
    room = path.relative_to(ROOT).parts[0]
    allowed = set(ROOMS[: ROOMS.index(room) + 1])
    others = imported(path) - set(sys.stdlib_module_names) - LATER - TYPES_ONLY - declared()
    assert others <= allowed, f"{path} imports {sorted(others - allowed)}"


def test_kernels_know_no_python_outside_the_binding():
    for path in (ROOT / "kernels" / "src").rglob("*.rs"):
        if "python" not in path.relative_to(ROOT / "kernels" / "src").parts[0]:
            assert not re.search(r"^\s*use (pyo3|numpy)\b", path.read_text(encoding="utf-8"), re.MULTILINE), (
                path
            )


def test_what_only_type_checkers_have_is_imported_for_them_alone():
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for block in [node for node in ast.walk(tree) if isinstance(node, ast.If)]:
            if ast.unparse(block.test) == "TYPE_CHECKING":
                block.body = [ast.Pass()]
        here = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert here.isdisjoint(TYPES_ONLY), path


@pytest.mark.parametrize("module", ["stages", "pipeline.run", "cli.app"])
def test_importing_is_light(module):
    code = f"import sys, {module}; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
