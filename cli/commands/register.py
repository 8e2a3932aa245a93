"""The command `register`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.output import Output
from scanloom.cli.paths import new_folder
from scanloom.cli.scan_argument import ScanFolder, read_scan
from scanloom.pipeline.skipped import emit_skipped
from scanloom.stages import InputError, RegisterParams, ScanParams
from scanloom.stages.scans.codes import SCAN_DEPTH_MISSING
from scanloom.stages.scans.read import require_complete


def register(
    folder: ScanFolder,
    target: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="Folder for poses and cloud.", show_default=False)
    ],
    scan: ScanParams,
    params: RegisterParams,
    out: Output,
) -> None:
    """Find the camera poses of a scan with depth from what its frames show.

    Poses it has are not used, except with --refine, which makes them better. OUTDIR gets trajectory.tum
    (camera-to-world), registration.json (matrices, edges, pieces, where the chain broke), path.ply (a
    coloured cloud, the camera's path in red), and pieces/ with the poses of what could not be joined. Of a
    thing that turned before a camera that stood still, it gets masks/, which show it alone.

    Example: scanloom register my_scan poses; scanloom fuse my_scan fused.ply --poses poses/trajectory.tum
    """
    from scanloom.pipeline.artifacts.poses import write_poses

    source = read_scan(folder, scan, complete=False)
    if source.is_stereo:
        raise InputError(
            SCAN_DEPTH_MISSING,
            "these are stereo pairs without depth",
            folder,
            remedy=(
                "run `scanloom depth {folder} OUTDIR`, register OUTDIR, or `scanloom run` for the whole way."
            ),
            folder=folder,
        )
    require_complete(source, folder, posed=False)
    with new_folder(target) as draft, out.progress("register", "frames") as progress:
        figures = write_poses(draft, stages.register(source, params, progress=progress))
    emit_skipped(figures["frames_skipped"])
    out.result({"output": str(target), **figures})
