"""The command `depth`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.output import Output
from scanloom.cli.paths import new_folder
from scanloom.cli.scan_argument import ScanFolder, read_scan
from scanloom.pipeline.skipped import emit_skipped
from scanloom.stages import DepthParams, ScanParams


def depth(
    folder: ScanFolder,
    target: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="Folder for the depth maps.", show_default=False)
    ],
    scan: ScanParams,
    params: DepthParams,
    out: Output,
) -> None:
    """Match the pairs or single views of a scan: depth maps, confidence and a coloured point cloud.

    With --model a network of your own does it, or fills in what was not measured.

    OUTDIR is then a scan folder itself, which `scanloom fuse` reads.

    Example: scanloom depth my_pairs my_depth --max-depth 30
    """
    from scanloom.pipeline.artifacts.depth_maps import choose_matcher, write_depth_maps

    source = read_scan(folder, scan)
    # Depth that was measured needs no matching; a network may fill it in.
    measure = stages.depth_scan if params.model is None and not source.is_views else choose_matcher(source)
    with new_folder(target) as draft, out.progress("depth", "pairs") as progress:
        figures = write_depth_maps(draft, measure(source, params, progress), source)
    emit_skipped(figures["frames_skipped"])
    out.result({"output": str(target), **figures})
