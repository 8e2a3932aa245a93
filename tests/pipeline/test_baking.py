"""The optional stage `bake`: its results, and their removal when it is disabled."""

from pathlib import Path

import pytest
from coloured_meshes import sheet

from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import list_skip_reasons, plan_stages
from scanloom.pipeline.steps.bake import BakeSection, write_baked
from scanloom.stages.comparing.compare import compare
from scanloom.stages.progress import ignore_progress
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.formats.gltf_materials import is_unlit
from scanloom.stages.surface.mesh_files import read_mesh


def make_scan() -> Scan:
    return Scan(frames=(), folder=None, layout="none")


@pytest.mark.slow
def test_bake_writes_a_glb_with_the_colours_of_the_original(tmp_path: Path):
    original = sheet(n=20)
    light = simplify(original, ratio=0.1).mesh
    metrics = write_baked(tmp_path, light, original, (0.0, -1.0, 0.0), BakeSection(), ignore_progress)
    baked = read_mesh(tmp_path / "baked.glb")
    found = compare(original, baked, samples=50_000).color_a_to_b
    assert found.rmse == pytest.approx(metrics["color"]["rmse_levels"], rel=0.1)
    assert baked.up == (0.0, -1.0, 0.0)
    assert found.psnr > metrics["vertex_color"]["psnr_db"] + 3


def test_bake_writes_maps_with_an_unlit_material(tmp_path: Path):
    original = sheet(n=20)
    light = simplify(original, ratio=0.1).mesh
    params = BakeSection(displacement_map=True)
    metrics = write_baked(tmp_path, light, original, None, params, ignore_progress)
    material = read_mesh(tmp_path / "baked.glb").texture.materials[0]
    assert is_unlit(material)
    assert {"normalTexture", "occlusionTexture"} <= set(material.kept.tree)
    displacement = tmp_path / "baked_maps" / "baked-displacement.png"
    assert displacement.stat().st_size == metrics["maps"]["displacement"]
    assert 0 < metrics["displacement_range_m"] < 0.1


def test_bake_is_planned_only_if_enabled():
    assert "bake.enabled=true" in list_skip_reasons(make_scan(), Config())["bake"]
    stages = {stage.name: stage for stage in plan_stages(make_scan(), Config().set(["bake.enabled=true"]))}
    assert stages["bake"].input_names == ("refined_mesh", "simplified_mesh", "up_direction")
    assert "bake" not in {stage.name for stage in plan_stages(make_scan(), Config())}
