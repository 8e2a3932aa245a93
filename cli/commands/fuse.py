"""Command `fuse`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import write_mesh_file
from scanloom.cli.output import Output
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file
from scanloom.cli.scan_argument import ScanFolder, read_scan
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.stages import FuseParams, InputError, ScanParams
from scanloom.stages.inspecting.consistency_checks import require_poses
from scanloom.stages.scans.codes import SCAN_DEPTH_MISSING


def fuse(
    folder: ScanFolder,
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="Mesh file to write (.ply, .obj, .off, .stl, .glb).", show_default=False
        ),
    ],
    scan: ScanParams,
    fuse: FuseParams,
    out: Output,
) -> None:
    """Fuse depth maps into a coloured mesh.

    Depth is integrated into a truncated signed distance field (TSDF). Stereo pairs and photos need depth
    first: run `scanloom depth`, and fuse its output.

    Example: scanloom fuse my_scan fused.ply --voxel-size 0.01

    Example: scanloom fuse my_scan fused.ply --set fuse.truncation=0.08 --set scan.first=100
    """
    require_new_file(target, MESH_SUFFIXES)
    source = read_scan(folder, scan)
    if source.is_stereo or source.is_views:
        what = "stereo pairs" if source.is_stereo else "single views"
        raise InputError(
            SCAN_DEPTH_MISSING,
            "these are {what} without depth",
            folder,
            remedy=(
                "run `scanloom depth {folder} OUTDIR` and fuse OUTDIR, or run all stages: `scanloom run`."
            ),
            what=what,
            folder=folder,
        )
    if scan.check_poses:
        require_poses(source)
    with out.progress("fuse", "frames") as progress:
        fused = stages.fuse(source, fuse, progress=progress)
    write_mesh_file(target, fused.mesh, out)
    metrics = fused.to_dict()
    warn_skipped_frames(metrics["frames_skipped"])
    out.result({"output": str(target), **metrics})
