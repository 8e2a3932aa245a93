"""Stage `adjust`: refines poses and colour camera with photos and depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from scanloom.pipeline.artifacts.adjusted_cameras import ADJUSTED_FOLDER, AdjustedCameras, write_adjusted
from scanloom.pipeline.artifacts.depth_maps import DepthMaps
from scanloom.pipeline.artifacts.posed_frames import load_frames
from scanloom.pipeline.artifacts.poses import Poses
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Context, Stage
from scanloom.stages.adjusting.adjust import AdjustParams, adjust
from scanloom.stages.inspecting.consistency_checks import require_poses, warn_inexact_poses
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.params import ScanParams


@dataclass(frozen=True, kw_only=True)
class AdjustInputs:
    """Inputs of the stage `adjust`."""

    frames: Scan | DepthMaps
    poses: Poses | None = None


def is_adjusted(scan: Scan, config: Sections) -> bool:
    """Return True if `adjust` applies.

    It requires frames with colour and measured depth.
    """
    if config.get(AdjustParams).enabled is False or scan.is_views:
        return False
    return any(frame.color is not None for frame in scan.frames)


def _run(inputs: AdjustInputs, params: AdjustParams, context: Context) -> Mapping[str, Any]:
    scan = load_frames(inputs.frames)
    if inputs.poses is not None:
        scan = inputs.poses.apply_to(scan)
    checks_poses = context.config.get(ScanParams).check_poses
    if checks_poses:
        # Reject a wrong pose convention here, as fuse does. Suspicious poses only produce a warning, see
        # below.
        require_poses(scan)
    is_measured = isinstance(inputs.frames, Scan)
    if not is_measured and params.depth is None:
        # The correction models the errors of a depth sensor. Depth from stereo pairs has other errors.
        params = replace(params, depth=False)
    # Poses of `register` come from the same depth, so they do not fix its scale.
    has_metric_poses = inputs.poses is None and is_measured
    found = adjust(scan, params, progress=context.progress, has_metric_poses=has_metric_poses)
    if found.accepted:
        (context.folder / ADJUSTED_FOLDER).mkdir()
        write_adjusted(context.folder / ADJUSTED_FOLDER, found)
    metrics = found.to_dict()
    # Only check sensor depth: depth from stereo pairs or views has correlated errors that look like pose
    # errors.
    if checks_poses and has_metric_poses and not found.accepted:
        warn_inexact_poses(scan.frames)
    return metrics


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    checks = (require_poses,) if config.get(ScanParams).check_poses else ()
    return collect_result_versions(adjust, *checks)


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:
    if is_adjusted(scan, config):
        return None
    if config.get(AdjustParams).enabled is False:
        return "is switched off"
    if scan.is_views:
        return "does not apply to this scan: its depth is computed from its poses"
    return "does not apply to this scan: its frames have no colour"


STAGE = Stage(
    name="adjust",
    section=AdjustParams,
    inputs=AdjustInputs,
    labels=("names", "times"),
    artifact=AdjustedCameras,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("opencv", "scipy"),
    result_names=(f"{ADJUSTED_FOLDER}/",),
    skip_reason=_get_skip_reason,
    cost=CostModel(
        seconds=2,
        seconds_per_megapixel=1,
        bytes=200e6,
        bytes_per_megapixel=6e6,
        depends_on_voxel_size=False,
        # The number of key frames is limited to 200.
        max_bytes=900e6,
    ),
    headline="{why}",
)
