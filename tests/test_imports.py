"""Imports go from cli to pipeline to stages to kernels, only to declared dependencies, and without cycles."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from import_graphs import Graph, build_python_graph, build_rust_graph, find_cycles

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("stages", "pipeline", "cli")
MODULES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
# Import names that differ from the name of their distribution.
IMPORTED_AS = {
    "backports.zstd": "backports",
    "opencv-contrib-python-headless": "cv2",
    "openexr": "OpenEXR",
    "pillow": "PIL",
    "scikit-image": "skimage",
    "pyyaml": "yaml",
    "libusb-package": "libusb_package",
}
# Part of the standard library only in some of the supported Python versions.
LATER = {"compression", "tomllib"}
# Provided by type checkers; no program imports it.
TYPES_ONLY = {"typing_extensions"}
# Files that import dependencies of extras and report a missing extra.
OF_EXTRAS = {
    "pipeline/batch/dask_executor.py": {"distributed": "distributed", "dask_jobqueue": "dask-jobqueue"},
    "pipeline/batch/summary.py": {"pyarrow": "pyarrow"},
    "stages/cleaning/solids/booleans.py": {"manifold3d": "manifold3d"},
    "stages/exporting/simulation/coacd_process.py": {"coacd": "coacd"},
    "stages/exporting/simulation/usd_physics.py": {"pxr": "usd-core"},
    "stages/exporting/usd.py": {"pxr": "usd-core"},
    "stages/surface/formats/e57.py": {"pye57": "pye57"},
    "stages/surface/formats/las.py": {"laspy": "laspy"},
    "stages/registration/structure/incremental_mapping.py": {"pycolmap": "pycolmap"},
    "stages/registration/structure/photo_features.py": {"pycolmap": "pycolmap"},
    "stages/stereo/networks/worker.py": {"onnxruntime": "onnxruntime"},
    "stages/rendering/plots.py": {"matplotlib": "matplotlib"},
}
# Generated; no module imports it at run time.
KEYWORDS = "scanloom.stages.params.keywords"
HEAVY = ("open3d", "cv2", "OpenEXR", "scipy", "trimesh")


@pytest.fixture(scope="module")
def graph() -> Graph:
    """Build the import graph of our Python modules."""
    # Only type checkers read the generated keyword module, which imports from all packages.
    return build_python_graph(ROOT, ROOMS, inside="scanloom") | {KEYWORDS: set()}


def find_imported_names(path: Path) -> set[str]:
    """Find the top-level names of all imports in a module; `scanloom.stages` etc. for scanloom's packages."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            is_ours = node.module == "scanloom"
            names |= {f"scanloom.{alias.name}" for alias in node.names} if is_ours else {node.module or ""}
    return {".".join(name.split(".")[: 2 if name.startswith("scanloom.") else 1]) for name in names}


@cache
def declared() -> set[str]:
    """List the import names of the required dependencies."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.match(r"[\w.-]+", line)[0].lower() for line in project["dependencies"]]
    return {IMPORTED_AS.get(name, name.replace("-", "_")) for name in names}


@cache
def in_extras() -> set[str]:
    """List the names of optional dependencies."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {name: lines for name, lines in project["optional-dependencies"].items() if name != "dev"}
    return {re.match(r"[\w.-]+", line)[0].lower() for lines in extras.values() for line in lines}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_one_way_and_are_declared(path):
    room = path.relative_to(ROOT).parts[0]
    allowed = {"scanloom", *(f"scanloom.{one}" for one in ROOMS[: ROOMS.index(room) + 1])}
    of_extras = OF_EXTRAS.get(path.relative_to(ROOT).as_posix(), {})
    assert set(of_extras.values()) <= in_extras()
    others = (
        find_imported_names(path)
        - set(sys.stdlib_module_names)
        - LATER
        - TYPES_ONLY
        - declared()
        - set(of_extras)
    )
    assert others <= allowed, f"{path} imports {sorted(others - allowed)}"


def test_python_has_no_import_cycle_of_files_or_folders(graph: Graph):
    assert len(graph["scanloom.stages"]) > 20
    found = find_cycles(graph)
    assert not found, "\n".join(["a circle of imports", *found])


def test_rust_has_no_import_cycle_of_files_or_folders():
    graph = build_rust_graph(ROOT / "kernels" / "src")

    assert len(graph["crate"]) > 10
    found = find_cycles(graph)
    assert not found, "\n".join(["a circle of imports", *found])


def test_code_fences_in_rust_comments_are_text():
    """Fenced code in Rust comments would be a doc test, and `make test` does not run doc tests."""
    for path in sorted((ROOT / "kernels" / "src").rglob("*.rs")):
        fences = re.findall(r"^\s*//[/!]\s*```(.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        assert set(fences[::2]) <= {"text"}, path


def test_only_stages_imports_the_kernels(graph: Graph):
    kernels = "scanloom.stages._kernels"
    using = {module.split(".")[1] for module, imported in graph.items() if kernels in imported}
    assert using == {"stages"}
    assert not graph[kernels]


def test_the_top_folder_of_stages_is_short():
    entries = {path.name for path in (ROOT / "stages").iterdir()} - {"__pycache__"}
    ours = {name for name in entries if not name.endswith((".so", ".pyd"))}

    assert len(ours) <= 26, sorted(ours)


def write_tree(root: Path, files: dict[str, str]) -> Path:
    """Write source files into a folder."""
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return root


PYTHON = {
    "a/__init__.py": "from a.fusing.fuse import fuse\n",
    "a/_compiled.pyi": "def run() -> None: ...\n",
    "a/words.py": "",
    "a/surface/__init__.py": "",
    "a/surface/mesh.py": "from a import _compiled\nimport a.words\n",
    "a/fusing/__init__.py": "",
    "a/fusing/fuse.py": "from a.surface.mesh import Mesh\nfrom a.fusing import plan\n",
    "a/fusing/plan.py": "import ast\nfrom a.words import WORDS\n",
    "b/__init__.py": "",
    "b/run.py": "import a.fusing.fuse\nfrom a import fuse\n",
}


def test_imports_of_python_are_found(tmp_path: Path):
    graph = build_python_graph(write_tree(tmp_path, PYTHON), ["a", "b"])

    assert graph["a"] == {"a.fusing.fuse"}
    assert graph["a.surface.mesh"] == {"a._compiled", "a.words"}
    assert graph["a.fusing.fuse"] == {"a.surface.mesh", "a.fusing.plan"}
    assert graph["b.run"] == {"a", "a.fusing.fuse"}
    assert find_cycles(graph) == []


@pytest.mark.parametrize(
    ("file", "line", "report"),
    [
        ("a/fusing/plan.py", "import a.fusing.fuse", "a.fusing.fuse → a.fusing.plan → a.fusing.fuse"),
        (
            "a/fusing/plan.py",
            "def f():\n    from a.fusing import fuse",
            "fuse → a.fusing.plan → a.fusing.fuse",
        ),
        ("a/fusing/plan.py", "if TYPE_CHECKING:\n    from a.fusing.fuse import fuse", "files: "),
        ("a/fusing/plan.py", "LATE = 'a.fusing.fuse'", "files: "),
        ("a/surface/mesh.py", "from a import fuse", "files: a → a.fusing.fuse → a.surface.mesh → a"),
        ("a/_compiled.pyi", "from a.surface.mesh import Mesh", "a._compiled → a.surface.mesh"),
        ("a/surface/topology.py", "import a.fusing.plan", "in a: a.fusing → a.surface → a.fusing"),
        ("a/words.py", "from a.surface import sheets", "in a: a.surface → a.words → a.surface"),
        ("a/fusing/grid/cell.py", "import a.fusing.plan", None),
        ("a/surface/edges.py", "import b.run", "in all: a → b → a"),
    ],
)
def test_an_import_cycle_in_python_is_reported(tmp_path: Path, file: str, line: str, report: str | None):
    changed = PYTHON | {"a/surface/sheets.py": "", file: f"{PYTHON.get(file, '')}{line}\n"}

    found = find_cycles(build_python_graph(write_tree(tmp_path, changed), ["a", "b"]))

    assert (report is None) == (not found)
    assert report is None or any(report in circle for circle in found), found


RUST = {
    "lib.rs": "//! See [`crate::snm`].\npub mod base;\nmod mesh;\npub(crate) mod snm;\n",
    "base/mod.rs": "pub mod ids;\npub mod errors;\n",
    "base/errors.rs": "use super::ids::{self, VertexId as V};\n",
    "base/ids.rs": "use std::fmt;\n\n#[cfg(test)]\nmod tests {\n    use crate::mesh::fan;\n}\n",
    "mesh/mod.rs": "pub mod fan;\npub mod star;\n",
    "mesh/star.rs": "use crate::base::{errors::Error, ids::{EdgeId, VertexId}};\n",
    "mesh/fan.rs": "fn fan(of: &super::star::Star) -> crate::base::ids::VertexId {} // not crate::snm\n",
    "snm.rs": "mod coder;\npub use coder::{Coder,\n    bits::*};\n",
    "snm/coder.rs": "pub mod bits;\n",
    "snm/coder/bits.rs": "use super::super::super::mesh;\n#[cfg(test)]\nmod tests;\n",
    "snm/coder/bits/tests.rs": "use crate::snm;\n",
}


def test_imports_of_rust_are_found(tmp_path: Path):
    graph = build_rust_graph(write_tree(tmp_path, RUST))

    assert graph == {
        "crate": {"crate.base", "crate.mesh", "crate.snm"},
        "crate.base": {"crate.base.ids", "crate.base.errors"},
        "crate.base.errors": {"crate.base.ids"},
        "crate.base.ids": set(),
        "crate.mesh": {"crate.mesh.fan", "crate.mesh.star"},
        "crate.mesh.star": {"crate.base.errors", "crate.base.ids"},
        "crate.mesh.fan": {"crate.mesh.star", "crate.base.ids"},
        "crate.snm": {"crate.snm.coder", "crate.snm.coder.bits"},
        "crate.snm.coder": {"crate.snm.coder.bits"},
        "crate.snm.coder.bits": {"crate.mesh"},
    }
    assert find_cycles(graph) == []


@pytest.mark.parametrize(
    ("file", "line", "report"),
    [
        ("mesh/star.rs", "use super::fan;", "files: crate.mesh.fan → crate.mesh.star → crate.mesh.fan"),
        ("mesh/star.rs", "fn f(fan: super::fan::Fan) {}", "in crate.mesh: crate.mesh.fan → crate.mesh.star"),
        ("mesh/star.rs", "use super::Options;", "files: crate.mesh → crate.mesh.star → crate.mesh"),
        ("mesh/star.rs", "use crate::Options;", "files: crate → crate.mesh → crate.mesh.star → crate"),
        ("base/lists.rs", "use crate::mesh::fan;", "in crate: crate.base → crate.mesh → crate.base"),
        ("mesh/star.rs", "use crate::{base, snm::coder};", "crate.mesh.star imports crate.snm.coder"),
    ],
)
def test_an_import_cycle_in_rust_is_reported(tmp_path: Path, file: str, line: str, report: str):
    changed = RUST | {file: f"{RUST.get(file, '')}{line}\n"}

    found = find_cycles(build_rust_graph(write_tree(tmp_path, changed)))

    assert any(report in circle for circle in found), found


@pytest.mark.parametrize("folder", ["tests", "benches"])
def test_every_rust_file_is_declared_by_mod(folder: str):
    # Rust ignores a file that no `mod` declares, so its tests would never run.
    root = ROOT / "kernels" / folder
    files = {path.parent.name if path.name == "mod.rs" else path.stem for path in root.rglob("*.rs")}

    named = re.findall(r"\bmod (\w+);", (root / "main.rs").read_text(encoding="utf-8"))

    assert files - {"main"} == set(named)


def test_kernels_use_python_only_in_the_binding():
    source = ROOT / "kernels" / "src"
    for path in source.rglob("*.rs"):
        if path.relative_to(source).parts[0] not in ("python", "python.rs"):
            code = re.sub(r"//.*", "", path.read_text(encoding="utf-8"))
            assert not re.search(r"\b(pyo3|numpy)\b", code), path


def test_modules_of_type_checkers_are_imported_for_type_checking_only():
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for block in [node for node in ast.walk(tree) if isinstance(node, ast.If)]:
            if ast.unparse(block.test) == "TYPE_CHECKING":
                block.body = [ast.Pass()]
        here = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert here.isdisjoint({*TYPES_ONLY, KEYWORDS}), path


@pytest.mark.parametrize(
    "module",
    ["scanloom", "scanloom.stages", "scanloom.pipeline.run.run", "scanloom.cli.app; scanloom.cli.app.app()"],
)
def test_importing_is_light(module):
    code = f"import sys, {module}; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
