"""The command `adjust`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.output import Output
from scanloom.cli.paths import new_folder
from scanloom.cli.scan_argument import ScanFolder, read_scan
from scanloom.stages import AdjustParams, InputError, ScanParams
from scanloom.stages.scans.codes import SCAN_DEPTH_MISSING
from scanloom.stages.scans.read import require_complete


def adjust(
    folder: ScanFolder,
    target: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="Folder for poses and cameras.", show_default=False)
    ],
    scan: ScanParams,
    params: AdjustParams,
    out: Output,
) -> None:
    """Make the poses of a scan with colour and depth better, and its colour camera where that is wrong.

    Points that several frames show are recognised; poses, points and one colour camera are fitted to where
    they are seen and how deep they are measured. What is not clearly better on points held out is not used.
    OUTDIR gets cameras.json (whether it is used and why, the colour camera, matrices) and, if it is better,
    trajectory.tum (camera-to-world). The scan's own files stay as they are.

    `scanloom run` does this on its way, and uses poses and colour camera; other commands take both with
    --adjusted OUTDIR/cameras.json.

    Example: scanloom adjust my_scan better
    """
    from scanloom.pipeline.artifacts.adjusted_cameras import write_adjusted

    source = read_scan(folder, scan, complete=False)
    if source.is_stereo or source.is_views:
        raise InputError(
            SCAN_DEPTH_MISSING,
            "these are images without depth",
            folder,
            remedy=(
                "run `scanloom depth {folder} OUTDIR` and adjust OUTDIR, or `scanloom run` for the whole way."
            ),
            folder=folder,
        )
    require_complete(source, folder)
    with new_folder(target) as draft, out.progress("adjust", "steps") as progress:
        found = stages.adjust(source, params, progress=progress)
        figures = write_adjusted(draft, found)
    out.result({"output": str(target), **figures, "seconds": found.seconds})
