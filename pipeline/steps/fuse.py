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

from scanloom.pipeline.artifacts.fused_bricks import KeptBricks
from scanloom.pipeline.artifacts.mesh_file import MeshFile
from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.artifacts.poses import Poses
from scanloom.pipeline.artifacts.up_direction import Up
from scanloom.pipeline.expectation import BASE_BYTES, Cost
from scanloom.pipeline.result_versions import result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped import emit_skipped
from scanloom.pipeline.stage import Context, Stage
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.documents import read_document
from scanloom.stages.fusion.fuse import Fused, fuse, fuse_to_file
from scanloom.stages.fusion.in_bricks import FusedInBricks, Kept
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.inspecting.libraries import installed
from scanloom.stages.inspecting.sanity import require_poses
from scanloom.stages.progress import Progress, silent
from scanloom.stages.registration.codes import REGISTER_NOT_CONNECTED
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.surface.formats.ply import write_ply

_PLANE = "plane.json"


@dataclass(frozen=True)
class FusedMesh(MeshFile):
    """Fused mesh."""

    NAME = "fused_mesh"
    FILE = "fused.ply"

    def load_plane_normal(self) -> Up | None:
        """Load the normal of the removed supporting plane, pointing up.

        Returns None if no plane was removed.
        """
        if not (self.folder / _PLANE).exists():
            return None
        x, y, z = read_document(self.folder / _PLANE)["up"]
        return x, y, z


def _run(inputs: PosedFrames, params: FuseParams, context: Context) -> Mapping[str, Any]:
    given = inputs.load_scan()
    scan = inputs.apply_to(given)
    if context.config.get(ScanParams).check_poses:
        require_poses(scan)
    kept = KeptBricks(context, scan, _versions({}, context.config), installed("opencv"))
    figures = write_fused(context.folder, scan, params, kept, context.progress).figures()
    if inputs.poses is not None:
        fuse_separate(context.folder, given, inputs.poses, params)
    emit_skipped(figures["frames_skipped"])
    return figures


def write_fused(
    folder: Path, scan: Scan, params: FuseParams, kept: Kept | None, progress: Progress = silent
) -> Fused | FusedInBricks:
    """Fuse a scan and write the mesh; `kept` is the store of fused bricks."""
    fused = fuse_to_file(scan, params, folder / FusedMesh.FILE, kept=kept, progress=progress)
    if fused.support is not None:
        (folder / _PLANE).write_text(
            json.dumps({"up": fused.support.normal}) + "\n", encoding="utf-8", newline="\n"
        )
    return fused


def fuse_separate(folder: Path, scan: Scan, poses: Poses, params: FuseParams) -> None:
    """Fuse each separate connected component of the registration into its own mesh.

    Each component has its own world frame. Components are not fused if fuse.box or fuse.center is set,
    because these coordinates only apply to the main component.
    """
    for number, piece in poses.load_separate(scan).items():
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
            *(one.at(f"component {number}") for one in diagnostics),
        )


def _versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    # Poses are only checked on request, so the version of the check only matters then.
    return result_versions(fuse, *((require_poses,) if config.get(ScanParams).check_poses else ()))


def _memory_bound(config: Sections) -> float:
    # The volume keeps to fuse.memory by fusing in bricks; everything else takes about as much again.
    return BASE_BYTES + 2e6 * config.get(FuseParams).memory


def _headline(figures: Mapping[str, Any]) -> str:
    if figures.get("truncation_m") == 0:
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
    writes=FusedMesh,
    run=_run,
    versions=_versions,
    libraries=installed("scanloom", "opencv", "open3d"),
    results=(FusedMesh.FILE, "pieces/"),
    cost=Cost(seconds_per_megapixel=0.4),
    headline=_headline,
    progress_unit="frames",
    memory_bound=_memory_bound,
)
