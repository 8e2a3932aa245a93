"""Adding a stage takes one file in each folder and a line in three tables."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from scanloom.pipeline.graph import STAGES
from scanloom.pipeline.stage import AnyStage

ROOT = Path(__file__).resolve().parents[2]

FUNCTION = '''"""Area of a mesh."""

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import compute_areas

RESULT_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class AreaParams:
    """Measure the area of the surface."""

    factor: float = param(1.0, "Multiply the area by this.", low=0, common=True)

    def __post_init__(self) -> None:
        check_parameters(self)


def area(mesh: Mesh, params: AreaParams) -> float:
    return params.factor * float(compute_areas(mesh.vertices, mesh.triangles).sum())
'''
STEP = '''"""The stage `area`: the area of the clean mesh."""

from dataclasses import dataclass

from scanloom.pipeline.result_versions import make_fixed_versions
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.clean import CleanMesh
from scanloom.stages.area.area import AreaParams, area


@dataclass(frozen=True)
class AreaFile(Artifact):
    NAME = "area"


@dataclass(frozen=True, kw_only=True)
class Inputs:
    clean_mesh: CleanMesh


def _run(inputs: Inputs, params: AreaParams, context: Context):
    found = area(inputs.clean_mesh.load(), params)
    (context.folder / "area.txt").write_text(f"{found}")
    return {"area_m2": found}


STAGE = Stage(
    name="area",
    section=AreaParams,
    inputs=Inputs,
    artifact=AreaFile,
    run=_run,
    versions=make_fixed_versions(area),
    result_names=("area.txt",),
    headline="{area_m2:.3g} m²",
)
'''
COMMAND = '''"""The command `area`."""

from scanloom.cli.mesh_arguments import MeshFile, read_mesh_file
from scanloom.cli.output import Output
from scanloom.stages.area.area import AreaParams
from scanloom.stages.area.area import area as measure


def area(source: MeshFile, area: AreaParams, out: Output) -> None:
    """Measure the area of a mesh."""
    out.result({"area_m2": measure(read_mesh_file(source), area)})
'''
LINES = (
    ("pipeline/graph.py", "    clean,\n", "    area,\n    clean,\n"),
    ("pipeline/graph.py", "    clean.STAGE,\n", "    clean.STAGE,\n    area.STAGE,\n"),
    (
        "pipeline/config.py",
        "\n\n@dataclass",
        "\nfrom scanloom.stages.area.area import AreaParams\n\n\n@dataclass",
    ),
    (
        "pipeline/config.py",
        "    upright: ",
        "    area: AreaParams = field(default_factory=AreaParams)\n    upright: ",
    ),
    ("cli/command_table.py", '        "clean",\n', '        "clean",\n        "area",\n'),
)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the checkout and add a stage to it."""
    root = tmp_path_factory.mktemp("checkout")
    for folder in ("scanloom", "stages", "pipeline", "cli"):
        ignored = shutil.ignore_patterns("node_modules", "__pycache__")
        shutil.copytree(ROOT / folder, root / folder, ignore=ignored)
    (root / "stages" / "area").mkdir()
    (root / "stages" / "area" / "__init__.py").write_text("")
    (root / "stages" / "area" / "area.py").write_text(FUNCTION)
    (root / "pipeline" / "steps" / "area.py").write_text(STEP)
    (root / "cli" / "commands" / "area.py").write_text(COMMAND)
    for file, before, after in LINES:
        text = (root / file).read_text(encoding="utf-8")
        assert before in text
        (root / file).write_text(text.replace(before, after, 1), encoding="utf-8")
    return root


def run_scanloom(checkout: Path, *words: str) -> str:
    program = "import sys; from scanloom.cli.app import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_new_stage_is_in_runs_help_toml_json_cache_and_report(checkout: Path, tmp_path: Path) -> None:
    assert "area" in run_scanloom(checkout, "--help")
    assert "--factor" in run_scanloom(checkout, "area", "--help")
    assert "[area]" in run_scanloom(checkout, "config")

    sample, out = ROOT / "samples" / "rgbd", tmp_path / "out"
    words = ("--set", "scan.every=6", "--set", "fuse.voxel_size=0.03", "--set", "area.factor=2")
    quick = ("--set", "adjust.enabled=false", "--set", "texture.enabled=false", "--set", "report.width=64")
    printed = json.loads(run_scanloom(checkout, "run", str(sample), "-o", str(out), *words, *quick, "--json"))
    stage = json.loads((out / "report.json").read_text())["stages"]["area"]
    assert stage["params"] == {"area": {"factor": 2.0}}
    assert stage["metrics"]["area_m2"] == float((out / "area.txt").read_text()) > 0
    assert printed["stages"]["area"]["metrics"] == stage["metrics"]
    assert len(list((out / "cache" / "area").iterdir())) == 1
    assert "area" in (out / "report.html").read_text(encoding="utf-8")
    alone = json.loads(run_scanloom(checkout, "area", str(out / "clean.ply"), "--json"))
    assert alone["area_m2"] == pytest.approx(stage["metrics"]["area_m2"] / 2)


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_inputs_are_named_after_artifacts_of_other_stages(stage: AnyStage) -> None:
    sources = {
        "scan",
        "scan_scale",
        "frames",
        "network",
        "photos",
        "held_out",
        "is_textured",
        "names",
        "times",
        "world",
    }
    earlier = {one.artifact.NAME for one in STAGES[: STAGES.index(stage)]}
    assert set(stage.input_names) <= sources | earlier


def test_artifact_names_are_unique() -> None:
    names = [stage.artifact.NAME for stage in STAGES]
    assert len(set(names)) == len(names)
