"""Stage `depth`: computes or completes depth maps.

Depth comes from stereo pairs, from posed views, or from a network that completes measured depth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.depth_maps import DepthMaps, choose_matcher, write_depth_maps
from scanloom.pipeline.artifacts.sparse_model import SparseModel
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import Context, Stage
from scanloom.stages.inspecting.epipolar_check import require_view_poses
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.transforms.scale import apply_scale
from scanloom.stages.stereo.depth import DepthParams, depth_scan
from scanloom.stages.stereo.network_depth import load_network
from scanloom.stages.stereo.networks.network import Network


@dataclass(frozen=True, kw_only=True)
class DepthInputs:
    """Inputs of the stage `depth`.

    Attributes
    ----------
    scan : scan without depth, or with depth that the network completes.
    sparse_model : cameras estimated by `structure`, if it ran.
    scan_scale : parameters with the scale of these cameras, if it is known.
    network : file of `depth.model`.
    """

    scan: Scan
    sparse_model: SparseModel | None = None
    scan_scale: ScanParams | None = None
    network: Path | None = None


def needs_depth(scan: Scan, config: Sections) -> bool:
    """Return True if depth is computed, by matching or a network."""
    return scan.is_stereo or scan.is_views or config.get(DepthParams).model is not None


def _run(inputs: DepthInputs, params: DepthParams, context: Context) -> Mapping[str, Any]:
    scan = _load_posed(inputs)
    if _is_pose_check_enabled(scan, context.config):
        require_view_poses(scan)
    measured = choose_matcher(scan)(scan, params, context.progress)
    metrics = write_depth_maps(context.folder, measured, scan)
    warn_skipped_frames(metrics["frames_skipped"])
    return metrics


def _load_posed(inputs: DepthInputs) -> Scan:
    if inputs.sparse_model is None:
        return inputs.scan
    if inputs.scan.has_poses:
        # Photos were added to the world of those with poses.
        return inputs.sparse_model.apply_to(inputs.scan)
    scan = inputs.sparse_model.apply_to(replace(inputs.scan, is_metric=False, scale=None))
    if inputs.scan_scale is None:
        return scan
    return apply_scale(scan, inputs.scan_scale, scan.folder or Path())


def _is_pose_check_enabled(scan: Scan, config: Sections) -> bool:
    return scan.is_views and config.get(ScanParams).check_poses


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:
    scan: Scan = known["scan"]
    network = () if config.get(DepthParams).model is None else (load_network, Network)
    checks = (require_view_poses,) if _is_pose_check_enabled(scan, config) else ()
    # depth_scan is always included, because views are matched in pairs by depth_scan.
    return collect_result_versions(depth_scan, choose_matcher(scan), *network, *checks)


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:
    if needs_depth(scan, config):
        return None
    return "does not apply to this scan: it is RGB-D and has measured depth"


STAGE = Stage(
    name="depth",
    section=DepthParams,
    inputs=DepthInputs,
    labels=("names", "world"),
    artifact=DepthMaps,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("opencv"),
    result_names=("points.ply",),
    skip_reason=_get_skip_reason,
    cost=CostModel(
        seconds_per_megapixel=0.5, bytes=500e6, bytes_per_megapixel=1e6, depends_on_voxel_size=False
    ),
    headline="{frames_used} pairs; depth for {used_ratio:.0%} of the pixels, median {median_depth_m:.3g} m, "
    "up to {max_depth_m:.3g} m",
    progress_unit="pairs",
)
