"""Stage `adjust`: refines poses and colour camera with photos and depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scanloom.pipeline.artifacts.adjusted_cameras import FOLDER, AdjustedCameras, write_adjusted
from scanloom.pipeline.artifacts.depth_maps import DepthMaps
from scanloom.pipeline.artifacts.posed_frames import load_frames
from scanloom.pipeline.artifacts.poses import Poses
from scanloom.pipeline.expectation import Cost
from scanloom.pipeline.result_versions import result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Context, Stage
from scanloom.stages.adjusting.adjust import AdjustParams, adjust
from scanloom.stages.inspecting.libraries import installed
from scanloom.stages.inspecting.sanity import pose_doubts, require_poses
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.params import ScanParams


@dataclass(frozen=True, kw_only=True)
class Inputs:
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


def _run(inputs: Inputs, params: AdjustParams, context: Context) -> Mapping[str, Any]:
    scan = load_frames(inputs.frames)
    if inputs.poses is not None:
        scan = inputs.poses.apply_to(scan)
    checks_poses = context.config.get(ScanParams).check_poses
    if checks_poses:
        # Reject a wrong pose convention here, as fuse does. Suspicious poses only produce a warning, see
        # below.
        require_poses(scan)
    found = adjust(scan, params, progress=context.progress)
    if found.accepted:
        (context.folder / FOLDER).mkdir()
        write_adjusted(context.folder / FOLDER, found)
    figures = found.figures()
    # Only check sensor depth: depth from stereo pairs or views has correlated errors that look like pose
    # errors.
    are_given = inputs.poses is None and isinstance(inputs.frames, Scan)
    if checks_poses and are_given and not found.accepted:
        pose_doubts(scan.frames)
    return figures


def _versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    checks = (require_poses,) if config.get(ScanParams).check_poses else ()
    return result_versions(adjust, *checks)


def _skip_reason(scan: Scan, config: Sections) -> str | None:
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
    inputs=Inputs,
    labels=("names", "times"),
    writes=AdjustedCameras,
    run=_run,
    versions=_versions,
    libraries=installed("opencv", "scipy"),
    results=(f"{FOLDER}/",),
    skip_reason=_skip_reason,
    cost=Cost(
        seconds=2,
        seconds_per_megapixel=1,
        bytes=200e6,
        bytes_per_megapixel=6e6,
        by_voxels=False,
        # The number of key frames is limited to 200.
        most_bytes=900e6,
    ),
    headline="{why}",
)
