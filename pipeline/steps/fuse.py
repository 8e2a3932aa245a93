"""Stage `fuse`: fuses all frames into one mesh.

fused.ply
fused.pieces.json      chunk table, if the mesh exceeds the in-memory limit
plane.json             normal of the supporting plane, if it was detected and removed
pieces/fused-N.ply     meshes of connected components that registration could not join to the main one
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.fused_bricks import CachedBrickStore
from scanloom.pipeline.artifacts.mesh_file import MeshFile
from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.artifacts.poses import Poses
from scanloom.pipeline.artifacts.up_direction import Up
from scanloom.pipeline.cost_model import BASE_BYTES, CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import Context, Stage
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.documents import read_document
from scanloom.stages.fusion.brick_fusion import BrickStore, FusedInBricks
from scanloom.stages.fusion.fuse import FusionResult, fuse, fuse_to_file
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.inspecting.consistency_checks import require_poses
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.registration.codes import REGISTER_NOT_CONNECTED
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.surface.formats.ply import write_ply

_PLANE_FILE = "plane.json"


@dataclass(frozen=True)
class FusedMesh(MeshFile):
    """Fused mesh."""

    NAME = "fused_mesh"
    FILE = "fused.ply"

    def load_plane_normal(self) -> Up | None:
        """Load the normal of the removed supporting plane, pointing up.

        Returns None if no plane was removed.
        """
        if not (self.folder / _PLANE_FILE).exists():
            return None
        x, y, z = read_document(self.folder / _PLANE_FILE)["up"]
        return x, y, z


def _run(inputs: PosedFrames, params: FuseParams, context: Context) -> Mapping[str, Any]:
    given = inputs.load_scan()
    scan = inputs.apply_to(given)
    if context.config.get(ScanParams).check_poses:
        require_poses(scan)
    kept = CachedBrickStore(
        context, scan, _list_versions({}, context.config), list_installed_versions("opencv")
    )
    metrics = write_fused(context.folder, scan, params, kept, context.progress).to_dict()
    if inputs.poses is not None:
        fuse_separate_components(context.folder, given, inputs.poses, params)
    warn_skipped_frames(metrics["frames_skipped"])
    return metrics


def write_fused(
    folder: Path,
    scan: Scan,
    params: FuseParams,
    bricks: BrickStore | None,
    progress: Progress = ignore_progress,
) -> FusionResult | FusedInBricks:
    """Fuse a scan and write the mesh; `bricks` is the store of fused bricks."""
    fused = fuse_to_file(scan, params, folder / FusedMesh.FILE, brick_store=bricks, progress=progress)
    if fused.support is not None:
        (folder / _PLANE_FILE).write_text(
            json.dumps({"up": fused.support.normal}) + "\n", encoding="utf-8", newline="\n"
        )
    return fused


def fuse_separate_components(folder: Path, scan: Scan, poses: Poses, params: FuseParams) -> None:
    """Fuse each separate connected component of the registration into its own mesh.

    Each component has its own world frame. Components are not fused if fuse.box or fuse.center is set,
    because these coordinates only apply to the main component.
    """
    for number, piece in poses.load_separate_components(scan).items():
        if params.box is not None or params.center is not None:
            emit(
                REGISTER_NOT_CONNECTED.warning(
                    "component {number} is not fused: fuse.box and fuse.center apply to the main one",
                    number=number,
                )
            )
            continue
        try:
            with collecting(forward=False) as diagnostics:
                fused = fuse(piece, params)
        except (InputError, UsageError) as error:
            emit(
                REGISTER_NOT_CONNECTED.warning(
                    "component {number} is not fused: {reason}", number=number, reason=str(error)
                )
            )
            continue
        pieces = folder / "pieces"
        pieces.mkdir(exist_ok=True)
        write_ply(pieces / f"fused-{number}.ply", fused.mesh)
        emit(
            REGISTER_NOT_CONNECTED.warning(
                "component {number} with {frames} frames is fused separately: pieces/fused-{number}.ply",
                number=number,
                frames=len(piece.frames),
            ),
            *(one.replace_location(f"component {number}") for one in diagnostics),
        )


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    # Poses are only checked on request, so the version of the check only matters then.
    return collect_result_versions(fuse, *((require_poses,) if config.get(ScanParams).check_poses else ()))


def _compute_memory_bound(config: Sections) -> float:
    # Fusion in bricks limits the volume to fuse.memory; everything else takes about as much again.
    return BASE_BYTES + 2e6 * config.get(FuseParams).memory


def _format_headline(metrics: Mapping[str, Any]) -> str:
    if metrics.get("truncation_m") == 0:
        # A single frame is triangulated directly, without a volume.
        return "{triangles:,} triangles from a single frame; depth up to {max_depth_m:.3g} m"
    return (
        "{triangles:,} triangles from {frames_used} frames; voxel size {voxel_size_m:.3g} m, truncation "
        "{truncation_m:.3g} m, depth up to {max_depth_m:.3g} m"
    )


STAGE = Stage(
    name="fuse",
    section=FuseParams,
    inputs=PosedFrames,
    labels=("names",),
    artifact=FusedMesh,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("scanloom", "opencv", "open3d"),
    result_names=(FusedMesh.FILE, "pieces/"),
    cost=CostModel(seconds_per_megapixel=0.4),
    headline=_format_headline,
    progress_unit="frames",
    memory_bound=_compute_memory_bound,
)
