"""Stage `register`: estimates camera poses from images and depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scanloom.pipeline.artifacts.depth_maps import DepthMaps
from scanloom.pipeline.artifacts.posed_frames import load_frames
from scanloom.pipeline.artifacts.poses import Poses, write_poses
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.result_versions import make_fixed_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.adjust import is_adjusted
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.registration.params import RegisterParams
from scanloom.stages.registration.register import register
from scanloom.stages.scans.model.scan import Scan


@dataclass(frozen=True, kw_only=True)
class RegisterInputs:
    """Inputs of the stage `register`."""

    frames: Scan | DepthMaps


def is_registered(scan: Scan, config: Sections) -> bool:
    """Return True if poses are estimated: if frames with depth have none, or on request."""
    params = config.get(RegisterParams)
    if params.enabled is None:
        return (not scan.has_poses and not scan.is_views) or (params.refine and not is_adjusted(scan, config))
    return params.enabled


def _run(inputs: RegisterInputs, params: RegisterParams, context: Context) -> Mapping[str, Any]:
    scan = load_frames(inputs.frames)
    found = register(scan, params, progress=context.progress)
    metrics = write_poses(context.folder, found, scan.folder)
    warn_skipped_frames(metrics["frames_skipped"])
    return metrics


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:
    if is_registered(scan, config):
        return None
    if config.get(RegisterParams).enabled is False:
        return "is switched off"
    if not scan.has_poses:
        return "does not apply to this scan: structure estimates the poses of photos without depth"
    return (
        "does not apply to this scan: its frames have poses; adjust refines them, and "
        "register.enabled=true estimates new ones"
    )


STAGE = Stage(
    name="register",
    section=RegisterParams,
    inputs=RegisterInputs,
    labels=("names", "times"),
    artifact=Poses,
    run=_run,
    versions=make_fixed_versions(register),
    libraries=list_installed_versions("opencv", "open3d"),
    result_names=("trajectory.tum", "path.ply", "pieces/", "masks/"),
    skip_reason=_get_skip_reason,
    cost=CostModel(
        seconds_per_megapixel=0.5, bytes=200e6, bytes_per_megapixel=1e6, depends_on_voxel_size=False
    ),
    headline="poses of {frames} frames of the {subject}; connected components: {pieces}",
)
