"""User modules may be named `stages`, `pipeline` and `cli`: scanloom only occupies its own import name."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from clashing_project import CODE, write_clashing_project

ROOT = Path(__file__).resolve().parents[1]


def run_python(folder: Path, *words: object, path: str = str(ROOT)) -> str:
    """Run Python in a folder and get its standard output."""
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_script_works_next_to_modules_of_the_same_names(tmp_path: Path) -> None:
    folder = write_clashing_project(tmp_path)
    lines = run_python(folder, CODE).splitlines()
    assert lines == [
        str(ROOT / "scanloom" / "__init__.py"),
        "stages cli steps",
        "4 quadric scanloom.pipeline.config",
    ]


def test_the_command_works_next_to_modules_of_the_same_names(tmp_path: Path) -> None:
    folder = write_clashing_project(tmp_path)
    # Like the script of an installation, but Python searches the current folder first.
    script = "import sys; from scanloom.cli.start import main; sys.argv = ['scanloom', '--version']; main()"
    assert run_python(folder, "-c", script, path=os.pathsep.join([".", str(ROOT)])).startswith("scanloom ")


def test_a_process_that_runs_jobs_finds_scanloom_in_a_relative_path() -> None:
    code = "from scanloom.pipeline.batch.process_handle import _ROOT; print(_ROOT.resolve())"
    assert run_python(ROOT, "-c", code, path=".").strip() == str(ROOT)


IN_A_CHECKOUT = {
    "packages": "import stages, pipeline, cli, scanloom.stages\n"
    "assert (stages, pipeline, cli) == (scanloom.stages, scanloom.pipeline, scanloom.cli)",
    "modules": "import stages.surface.mesh, scanloom.stages.surface.mesh as ours\n"
    "assert stages.surface.mesh is ours",
    "short names second": "import scanloom.stages.surface.mesh as ours, stages.surface.mesh\n"
    "assert stages.surface.mesh is ours",
    "names": "from scanloom import Mesh\nfrom stages import Mesh as same\nassert Mesh is same",
    "specs": "import stages.files.input_files as opening\n"
    "assert (opening.__name__, opening.__spec__.name) == ('scanloom.stages.files.input_files', "
    "opening.__name__)",
    "no copies": "import sys, stages, cli.app, pipeline.run.run\ncli.app.app()\n"
    "files = {id(one): one.__file__ for one in sys.modules.values() if getattr(one, '__file__', None)}\n"
    "ours = [path for path in files.values() if path.startswith(sys.argv[1])]\n"
    "assert len(ours) > 100 and len(ours) == len(set(ours)), ours",
    "pickles": "import pickle, stages\n"
    "assert pickle.loads(pickle.dumps(stages.SimplifyParams)) is stages.SimplifyParams\n"
    "assert b'scanloom.stages' in pickle.dumps(stages.SimplifyParams)",
    "missing modules": "from importlib.util import find_spec\nimport stages\n"
    "assert find_spec('stages.nothing') is None\n"
    "try:\n    import stages.nothing\nexcept ModuleNotFoundError as error:\n"
    "    assert error.name == 'stages.nothing'",
}


@pytest.mark.parametrize("code", IN_A_CHECKOUT.values(), ids=list(IN_A_CHECKOUT))
def test_the_folders_of_a_checkout_are_the_same_modules(code: str) -> None:
    run_python(ROOT, "-c", code, ROOT)


def test_modules_of_a_checkout_run_by_their_short_names() -> None:
    assert "Usage" in run_python(ROOT, "-m", "cli.app", "check", "--help")


def test_spawned_processes_have_the_same_classes(tmp_path: Path) -> None:
    program = """
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import scanloom


def simplified(mesh):
    return scanloom.simplify(mesh, triangles=4)


if __name__ == "__main__":
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
    mesh = scanloom.Mesh(points, np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], np.int32))
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        print(type(pool.submit(simplified, mesh).result()) is scanloom.SimplificationResult)
"""
    folder = write_clashing_project(tmp_path)
    (folder / "program.py").write_text(program)
    assert run_python(folder, "program.py") == "True\n"
