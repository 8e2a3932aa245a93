"""Command `adjust`."""

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
from scanloom.stages.scans.reader import require_complete


def adjust(
    folder: ScanFolder,
    target: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="New folder for poses and cameras.", show_default=False)
    ],
    scan: ScanParams,
    adjust: AdjustParams,
    out: Output,
) -> None:
    """Refine the poses and colour camera of a scan.

    Points are matched across frames; poses, points and one colour camera are fitted to the matches and to the
    measured depth. The result is used only if it is clearly better on held-out points. OUTDIR gets
    cameras.json (decision, colour camera, matrices) and, if it is better, trajectory.tum (camera-to-world).
    The files of the scan are not changed.

    `scanloom run` includes this stage. Other commands use its result by --set
    scan.adjusted_cameras=OUTDIR/cameras.json.

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
                "run `scanloom depth {folder} OUTDIR` and adjust OUTDIR, or run all stages: `scanloom run`."
            ),
            folder=folder,
        )
    require_complete(source, folder)
    with new_folder(target) as draft, out.progress("adjust", "steps") as progress:
        found = stages.adjust(source, adjust, progress=progress)
        metrics = write_adjusted(draft, found)
    out.result({"output": str(target), **metrics, "seconds": found.seconds})
