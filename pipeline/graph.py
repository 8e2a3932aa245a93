"""Stages of the pipeline, in execution order.

scan ──structure──▶ sparse_model ─▼     (photos without poses only)
scan ──depth──▶ frames ──────────────fuse──▶ fused_mesh ──clean──▶ clean_mesh ──refine──▶ refined_mesh
                  ├─register─▶ poses ─▲
                  └─adjust──▶ adjusted_cameras

refined_mesh ──simplify──▶ simplified_mesh

simplified_mesh ──texture──▶ textured_mesh      refined_mesh ──lod──▶ levels ──tiles──▶ tileset
simplified_mesh ──bake────▶ baked_mesh          simplified_mesh ──export──▶ exported_models
simplified_mesh ──remesh──▶ normal_mesh         clean_mesh ──coverage──▶ coverage_map
clean_mesh ──upright──▶ up_direction            all meshes ──report──▶ report

An RGB-D scan is used as `frames` directly. The remaining inputs of each stage are listed in its file in
`pipeline/steps/`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import AnyStage
from scanloom.pipeline.steps import (
    adjust,
    bake,
    clean,
    coverage,
    depth,
    export,
    fuse,
    lod,
    refine,
    register,
    remesh,
    report,
    simplify,
    structure,
    texture,
    tiles,
    upright,
)
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.stereo.depth import DepthParams

STAGES: tuple[AnyStage, ...] = (
    structure.STAGE,
    depth.STAGE,
    register.STAGE,
    adjust.STAGE,
    fuse.STAGE,
    clean.STAGE,
    refine.STAGE,
    upright.STAGE,
    simplify.STAGE,
    texture.STAGE,
    bake.STAGE,
    remesh.STAGE,
    lod.STAGE,
    tiles.STAGE,
    export.STAGE,
    coverage.STAGE,
    report.STAGE,
)

# Inputs without a value: they only enter the cache keys of stages whose results contain them. See
# `scanloom.pipeline.cache.digest.compute_label_digests`.
LABELS = ("names", "times", "world")


def find_stage(name: str) -> AnyStage | None:
    """Find a stage by name."""
    return next((stage for stage in STAGES if stage.name == name), None)


def get_scan_input_name(scan: Scan, config: Sections) -> str:
    """Return the input name of the scan: "scan" if depth is computed, else "frames"."""
    return "scan" if depth.needs_depth(scan, config) else "frames"


def is_textured(scan: Scan, config: Sections) -> bool:
    """Return True if the simplified mesh gets a texture, so that its vertex colours do not matter."""
    return texture.STAGE.skip_reason(scan, config) is None


def list_skip_reasons(scan: Scan, config: Sections) -> Mapping[str, str]:
    """Return the skipped stages of a scan with the reasons."""
    reasons = {stage.name: stage.skip_reason(scan, config) for stage in STAGES}
    return {name: reason for name, reason in reasons.items() if reason is not None}


def plan_stages(scan: Scan, config: Sections) -> Sequence[AnyStage]:
    """Plan the stages of a scan, each with its available inputs."""
    skipped = list_skip_reasons(scan, config)
    stages = [stage for stage in STAGES if stage.name not in skipped]
    scan_name = get_scan_input_name(scan, config)
    available = {scan_name, *(stage.artifact.NAME for stage in stages)}
    if scan.held_out:
        available.add("held_out")
    if structure.has_estimated_world(scan) and scan.is_metric:
        available.add("scan_scale")
    if config.get(DepthParams).model is not None:
        available.add("network")
    if config.get(texture.TextureSection).images is not None:
        available.add("photos")
    if is_textured(scan, config):
        available.add("is_textured")
    plan = []
    for stage in stages:
        reads = [name for name in stage.input_names if name not in stage.ignored_inputs(config)]
        # Frames written by the depth stage are numbered and have no time stamps, so labels do not apply.
        labels = LABELS if scan_name in reads else ()
        reads = [name for name in reads if name in available or name in labels]
        plan.append(replace(stage, input_names=tuple(reads)))
    return plan
