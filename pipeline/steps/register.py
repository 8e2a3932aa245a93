"""Stage `register`: estimates camera poses from images and depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scanloom.pipeline.artifacts.depth_maps import DepthMaps
from scanloom.pipeline.artifacts.posed_frames import load_frames
from scanloom.pipeline.artifacts.poses import Poses, write_poses
from scanloom.pipeline.expectation import Cost
from scanloom.pipeline.result_versions import always
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped import emit_skipped
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.adjust import is_adjusted
from scanloom.stages.inspecting.libraries import installed
from scanloom.stages.registration.params import RegisterParams
from scanloom.stages.registration.register import register
from scanloom.stages.scans.model.scan import Scan


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Inputs of the stage `register`."""

    frames: Scan | DepthMaps


def is_registered(scan: Scan, config: Sections) -> bool:
    """Return True if poses are estimated: if poses are missing, or on request."""
    params = config.get(RegisterParams)
    if params.enabled is None:
        return not scan.has_poses or (params.refine and not is_adjusted(scan, config))
    return params.enabled


def _run(inputs: Inputs, params: RegisterParams, context: Context) -> Mapping[str, Any]:
    scan = load_frames(inputs.frames)
    found = register(scan, params, progress=context.progress)
    figures = write_poses(context.folder, found, scan.folder)
    emit_skipped(figures["frames_skipped"])
    return figures


def _skip_reason(scan: Scan, config: Sections) -> str | None:
    if is_registered(scan, config):
        return None
    if config.get(RegisterParams).enabled is False:
        return "is switched off"
    return (
        "does not apply to this scan: its frames have poses; adjust refines them, and "
        "register.enabled=true estimates new ones"
    )


STAGE = Stage(
    name="register",
    section=RegisterParams,
    inputs=Inputs,
    labels=("names", "times"),
    writes=Poses,
    run=_run,
    versions=always(register),
    libraries=installed("opencv", "open3d"),
    results=("trajectory.tum", "path.ply", "pieces/", "masks/"),
    skip_reason=_skip_reason,
    cost=Cost(seconds_per_megapixel=0.5, bytes=200e6, bytes_per_megapixel=1e6, by_voxels=False),
    headline="poses of {frames} frames of the {subject}; connected components: {pieces}",
)
