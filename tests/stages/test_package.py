"""Names of `import scanloom`: they are imported lazily, and no submodule hides them."""

import ast
import subprocess
import sys
from importlib import import_module, metadata
from pathlib import Path

import pytest

import scanloom
from scanloom import stages
from scanloom.stages.files.version import get_installed_version

ROOT = Path(stages.__file__).parent
TREE = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))


def list_type_checking_imports() -> dict[str, str]:
    """List names and modules of the imports under `if TYPE_CHECKING`."""
    (block,) = [n for n in TREE.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    assert all(alias.asname is None for node in imports for alias in node.names)
    return {alias.name: node.module for node in imports for alias in node.names}


def run_in_new_process(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_type_checkers_and_the_program_see_the_same_names_of_the_same_modules():
    assert list_type_checking_imports() == stages._MODULE_OF
    assert sorted(stages.__all__) == sorted({*stages._MODULE_OF, "__version__"}) == dir(stages)


@pytest.mark.parametrize("name", sorted(stages._MODULE_OF))
def test_every_name_is_the_object_of_its_module(name):
    assert getattr(stages, name) is getattr(import_module(stages._MODULE_OF[name]), name)


def test_importing_the_package_imports_nothing_else():
    listed = "[name for name in sys.modules if name.startswith('scanloom.') or name == 'numpy']"
    assert run_in_new_process(f"import sys, scanloom; print({listed})") == "[]"
    assert run_in_new_process(f"import sys, scanloom.stages; print({listed})") == "['scanloom.stages']"


def test_a_star_import_gives_all_names():
    for package in ("scanloom", "scanloom.stages"):
        code = f"from {package} import *; print(simplify.__name__, Mesh.__name__)"
        assert run_in_new_process(code) == "simplify Mesh"
    assert run_in_new_process("from scanloom import *; print(show.__name__, Page.__name__)") == "show Page"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"'scanloom\.stages' has no attribute 'simplfy'"):
        stages.simplfy  # noqa: B018
    with pytest.raises(AttributeError, match="'scanloom' has no attribute 'simplfy'"):
        scanloom.simplfy  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'simplfy'"):
        from scanloom import simplfy  # noqa: F401


def test_the_top_has_the_same_names_and_the_packages():
    assert scanloom.__all__ == sorted([*stages.__all__, "Page", "show"])
    assert set(dir(scanloom)) == {*scanloom.__all__, "stages", "pipeline", "cli"}
    assert all(getattr(scanloom, name) is getattr(stages, name) for name in stages.__all__)
    assert scanloom.show is import_module("scanloom.pipeline.report.page.show").show


def test_no_module_has_the_name_of_a_function():
    # Importing a submodule binds its name in the package and would hide a function of that name.
    entries = {path.stem for path in ROOT.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert entries.isdisjoint(stages.__all__)
    code = (
        "import scanloom; from scanloom import stages; from importlib import import_module; "
        "names = ('simplification.simplify', 'cleaning.clean', 'inspecting.inspect'); "
        "[import_module(f'scanloom.stages.{name}') for name in names]; "
        "print(all(callable(getattr(stages, name.split('.')[1])) for name in names))"
    )
    assert run_in_new_process(code) == "True"


def test_version_is_that_of_the_installed_distribution(monkeypatch):
    assert stages.__version__ == metadata.version("scanloom")

    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", missing)
    assert get_installed_version() == "0+unknown"


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.py")), ids=lambda path: str(path.relative_to(ROOT)))
def test_modules_import_from_modules_and_not_from_the_package(path):
    # Importing a name from the package during the import of the package would depend on the order of imports.
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module in ("scanloom", "scanloom.stages"):
            assert [alias.name for alias in node.names] == ["_kernels"]
        elif isinstance(node, ast.Import):
            assert {"scanloom", "scanloom.stages"}.isdisjoint(alias.name for alias in node.names)
