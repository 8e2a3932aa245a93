"""Command `depth`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.output import Output
from scanloom.cli.paths import new_folder
from scanloom.cli.scan_argument import ScanFolder, read_scan
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.stages import DepthParams, ScanParams


def depth(
    folder: ScanFolder,
    target: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="New folder for the depth maps.", show_default=False)
    ],
    scan: ScanParams,
    depth: DepthParams,
    out: Output,
) -> None:
    """Compute depth maps from stereo pairs or views.

    OUTDIR gets depth maps, confidence maps and a coloured point cloud, and is a scan folder that
    `scanloom fuse` reads. --model uses a neural network of your own, for matching or to fill in missing
    depth.

    Example: scanloom depth my_pairs my_depth --max-depth 30
    """
    from scanloom.pipeline.artifacts.depth_maps import choose_matcher, write_depth_maps

    source = read_scan(folder, scan)
    # Scans with depth need no matching; a network can fill in missing depth.
    measure = stages.depth_scan if depth.model is None and not source.is_views else choose_matcher(source)
    with new_folder(target) as draft, out.progress("depth", "pairs") as progress:
        metrics = write_depth_maps(draft, measure(source, depth, progress), source)
    warn_skipped_frames(metrics["frames_skipped"])
    out.result({"output": str(target), **metrics})
