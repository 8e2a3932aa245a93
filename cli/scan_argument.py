"""Scan folder as an argument of commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.paths import require_scan
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.stages import Scan, ScanParams

ScanFolder = Annotated[
    Path,
    typer.Argument(
        metavar="SCAN",
        help="Folder of the scan, or a recording (.bag, .db3, .sens, .r3d).",
        show_default=False,
    ),
]


def read_scan(folder: Path, params: ScanParams, *, complete: bool = True) -> Scan:
    """Read a scan; unusable frames are reported.

    Parameters
    ----------
    complete : refuse a scan that lacks poses, depth or other data of its layout.
    """
    scan = stages.read_scan(require_scan(folder), params, complete=complete)
    warn_skipped_frames([one.to_dict() for one in scan.skipped_frames])
    return scan
