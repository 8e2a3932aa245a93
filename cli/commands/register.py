"""Command `register`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.output import Output
from scanloom.cli.paths import new_folder
from scanloom.cli.scan_argument import ScanFolder, read_scan
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.stages import InputError, RegisterParams, ScanParams
from scanloom.stages.scans.codes import SCAN_DEPTH_MISSING
from scanloom.stages.scans.reader import require_complete


def register(
    folder: ScanFolder,
    target: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="New folder for poses and cloud.", show_default=False)
    ],
    scan: ScanParams,
    register: RegisterParams,
    out: Output,
) -> None:
    """Estimate the camera poses of a scan with depth.

    Poses of the scan are ignored, except with --refine. OUTDIR gets trajectory.tum (camera-to-world),
    registration.json (matrices, pose graph, disconnected components), path.ply (a coloured cloud with the
    path of the camera), and pieces/ with the poses of other components. For an object on a turntable before
    a static camera, masks/ separates it from the background.

    Example: scanloom register my_scan poses

    Example: scanloom fuse my_scan fused.ply --poses poses/trajectory.tum
    """
    from scanloom.pipeline.artifacts.poses import write_poses

    source = read_scan(folder, scan, complete=False)
    if source.is_stereo:
        raise InputError(
            SCAN_DEPTH_MISSING,
            "these are stereo pairs without depth",
            folder,
            remedy=(
                "run `scanloom depth {folder} OUTDIR`, register OUTDIR, or run all stages: `scanloom run`."
            ),
            folder=folder,
        )
    require_complete(source, folder, posed=False)
    with new_folder(target) as draft, out.progress("register", "frames") as progress:
        metrics = write_poses(draft, stages.register(source, register, progress=progress))
    warn_skipped_frames(metrics["frames_skipped"])
    out.result({"output": str(target), **metrics})
