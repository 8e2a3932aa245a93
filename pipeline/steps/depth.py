"""Stage `depth`: computes or completes depth maps.

Depth comes from stereo pairs, from posed views, or from a network that completes measured depth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.depth_maps import DepthMaps, choose_matcher, write_depth_maps
from scanloom.pipeline.expectation import Cost
from scanloom.pipeline.result_versions import result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped import emit_skipped
from scanloom.pipeline.stage import Context, Stage
from scanloom.stages.inspecting.libraries import installed
from scanloom.stages.inspecting.view_poses import require_view_poses
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.stereo.by_network import network_of
from scanloom.stages.stereo.depth import DepthParams, depth_scan
from scanloom.stages.stereo.networks.network import Network


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Inputs of the stage `depth`.

    Attributes
    ----------
    scan : scan without depth, or with depth that the network completes.
    network : file of `depth.model`.
    """

    scan: Scan
    network: Path | None = None


def needs_depth(scan: Scan, config: Sections) -> bool:
    """Return True if depth is computed, by matching or a network."""
    return scan.is_stereo or scan.is_views or config.get(DepthParams).model is not None


def _run(inputs: Inputs, params: DepthParams, context: Context) -> Mapping[str, Any]:
    scan = inputs.scan
    if _checks_poses(scan, context.config):
        require_view_poses(scan)
    measured = choose_matcher(scan)(scan, params, context.progress)
    figures = write_depth_maps(context.folder, measured, scan)
    emit_skipped(figures["frames_skipped"])
    return figures


def _checks_poses(scan: Scan, config: Sections) -> bool:
    return scan.is_views and config.get(ScanParams).check_poses


def _versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:
    scan: Scan = known["scan"]
    network = () if config.get(DepthParams).model is None else (network_of, Network)
    checks = (require_view_poses,) if _checks_poses(scan, config) else ()
    # depth_scan is always included, because views are matched in pairs by depth_scan.
    return result_versions(depth_scan, choose_matcher(scan), *network, *checks)


def _skip_reason(scan: Scan, config: Sections) -> str | None:
    if needs_depth(scan, config):
        return None
    return "does not apply to this scan: it is RGB-D and has measured depth"


STAGE = Stage(
    name="depth",
    section=DepthParams,
    inputs=Inputs,
    labels=("names", "world"),
    writes=DepthMaps,
    run=_run,
    versions=_versions,
    libraries=installed("opencv"),
    results=("points.ply",),
    skip_reason=_skip_reason,
    cost=Cost(seconds_per_megapixel=0.5, bytes=500e6, bytes_per_megapixel=1e6, by_voxels=False),
    headline="{frames_used} pairs; depth for {used_share:.0%} of the pixels, median {median_depth_m:.3g} m, "
    "up to {max_depth_m:.3g} m",
    progress_unit="pairs",
)
