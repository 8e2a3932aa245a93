"""A changed algorithm never hits the cache: every RESULT_VERSION is in the key of a stage that runs it."""

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from chunked_sample import use_small_chunks
from importable_modules import import_modules

from scanloom import pipeline, stages
from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import STAGES
from scanloom.pipeline.stage import Stage
from scanloom.pipeline.steps.clean import CleanMesh
from scanloom.pipeline.steps.refine import RefinedMesh
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
from scanloom.stages.surface.chunk_partition import write_in_chunks
from scanloom.stages.surface.chunked_ply import make_table_path
from scanloom.stages.surface.mesh import Mesh

ROOT = Path(stages.__file__).parents[1]
MODULES = import_modules(pipeline, stages)
STATING = [module for module in MODULES if hasattr(module, "RESULT_VERSION")]

CAMERA = Camera(8, 8, 8.0, 8.0, 3.5, 3.5)
VIEWS = Scan("toy", [Frame("0", CAMERA)])
PAIRS = Scan("toy", [Frame("0", CAMERA)], rig=StereoRig(CAMERA, CAMERA, None, is_rectified=True))
# Measured depth, which a network may complete.
MEASURED = Scan("toy", [Frame("0", CAMERA, depth=Path("0.png"))])
METHODS = (
    "simplify.ratio=0.5",
    "simplify.method=certified simplify.max_shape=0.01",
    "simplify.method=planar",
    "simplify.method=jia01",
    "simplify.method=seams simplify.ratio=0.5",
    "simplify.bake=true simplify.ratio=0.5",
    "clean.repair=true simplify.ratio=0.5",
    "depth.model=net.onnx",
)


@cache
def config(words: str) -> Config:
    return Config().set(words.split())


def compute_versions(stage: Stage, scan: Scan, words: str = "", clean: Path = ROOT) -> Mapping[str, int]:
    known = {
        **dict.fromkeys(stage.input_names, scan),
        "clean_mesh": CleanMesh(clean),
        "refined_mesh": RefinedMesh(clean),
    }
    return stage.versions(known, config(words))


def compute_all_versions(large: Path) -> dict[tuple[Any, ...], Mapping[str, int]]:
    """Compute the versions in the keys of all stages, for all kinds of scans and methods.

    `large` contains a chunked mesh.
    """
    return {
        (stage.name, (scan.is_views, scan.is_stereo), words, clean): compute_versions(
            stage, scan, words, clean
        )
        for stage in STAGES
        for scan in (VIEWS, PAIRS, MEASURED)
        for words in METHODS
        for clean in (ROOT, large)
    }


@pytest.fixture
def large(tmp_path: Path) -> Path:
    triangle = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    with use_small_chunks(max_in_memory=0):
        for name in ("clean.ply", "refined.ply"):
            write_in_chunks(tmp_path / name, triangle, {})
            assert make_table_path(tmp_path / name).exists()
    return tmp_path


def get_stage(name: str) -> Stage:
    return next(stage for stage in STAGES if stage.name == name)


def test_modules_with_versions_are_found():
    names = {module.__name__ for module in STATING}
    assert {
        "scanloom.stages.fusion.fuse",
        "scanloom.stages.simplification.simplify",
        "scanloom.pipeline.evaluation.measurements",
    } <= names
    assert len(STATING) >= 12


@pytest.mark.parametrize("module", STATING, ids=lambda module: module.__name__)
def test_every_version_of_a_result_is_in_the_key_of_a_stage(module, large, monkeypatch):
    before = compute_all_versions(large)
    monkeypatch.setattr(module, "RESULT_VERSION", module.RESULT_VERSION + 1)
    after = compute_all_versions(large)
    assert [key for key in before if before[key] != after[key]], "bumping it changes no key"


def test_every_stage_has_a_version(large):
    assert all(compute_all_versions(large).values())


def test_version_constants_have_specific_names():
    # RESULT_VERSION is for cache keys, FORMAT_VERSION for readers of files.
    unclear = {"VERSION", "_VERSION"}
    assert [module for module in MODULES if unclear & vars(module).keys()] == []


def test_the_version_of_a_method_is_in_the_key_only_where_it_runs():
    simplify = get_stage("simplify")
    assert set(compute_versions(simplify, PAIRS, "simplify.ratio=0.5")) == {"simplify", "quadric"}
    assert set(compute_versions(simplify, PAIRS, "simplify.method=planar")) == {"simplify", "planar"}
    baked = compute_versions(simplify, PAIRS, "simplify.ratio=0.5 simplify.bake=true")
    assert set(baked) == {"simplify", "quadric", "bake", "compare"}
    assert set(compute_versions(simplify, PAIRS, "simplify.max_shape=0.01")) == {
        "simplify",
        "certified",
        "certify",
    }


def test_invalid_parameters_of_methods_do_not_fail_the_key():
    assert set(compute_versions(get_stage("simplify"), PAIRS, "simplify.method=quadric")) == {"simplify"}


def test_a_mesh_too_large_for_refinement_has_a_separate_key(large):
    refine = get_stage("refine")
    refined = set(compute_versions(refine, MEASURED))
    assert (
        refined
        == set(compute_versions(refine, MEASURED, clean=large))
        == {"refine", "depth_noise", "clean", "certify"}
    )
    assert set(compute_versions(refine, MEASURED, "refine.memory=1", clean=large)) == {"copy"}
    # The limit only concerns chunked meshes.
    assert set(compute_versions(refine, MEASURED, "refine.memory=1")) == refined


def test_depth_has_the_version_of_views_only_for_views():
    assert set(compute_versions(get_stage("depth"), VIEWS)) == {"depth", "views_depth", "epipolar_check"}
    unchecked = compute_versions(get_stage("depth"), VIEWS, "scan.check_poses=false")
    assert set(unchecked) == {"depth", "views_depth"}
    assert set(compute_versions(get_stage("depth"), PAIRS)) == {"depth"}


def test_depth_has_the_version_of_networks_only_with_one():
    found = set(compute_versions(get_stage("depth"), PAIRS, "depth.model=net.onnx"))
    assert found == {"depth", "network_depth", "network"}


def get_name_in_keys(module: ModuleType) -> str:
    """Get the name of a file or of a method; a method is called in the file `run.py` of its folder."""
    *_, folder, file = module.__name__.split(".")
    return folder if file == "run" and folder != "pipeline" else file


@cache
def list_cached_imports(module: ModuleType) -> frozenset[str]:
    return frozenset(list_imports(module))


def list_imports(module: ModuleType) -> Iterator[str]:
    if module.__file__.endswith(".py"):
        for node in ast.walk(ast.parse(Path(module.__file__).read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                yield node.module
                yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_versions_of_imported_modules_are_in_the_key(large):
    # Code that is imported by a stage may change its result; for example, bake measures colours with compare.
    by_name = {module.__name__: module for module in MODULES}
    stating = {get_name_in_keys(module): module.__name__ for module in STATING}
    in_keys = compute_all_versions(large)
    for stage in STAGES:
        named = {name for key, found in in_keys.items() if key[0] == stage.name for name in found}
        # A file of `pipeline/steps/` states its version in the stage.
        reached, waiting = set(), {stating[name] for name in named & stating.keys()}
        while waiting:
            one = waiting.pop()
            reached.add(one)
            waiting |= {name for name in list_cached_imports(by_name[one]) if name in by_name} - reached
        missing = {name for name, module in stating.items() if module in reached} - named
        assert not missing, f"{stage.name} may run {missing}"
