"""Command `refine`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import locate_diagnostics, read_mesh_file, write_mesh_file
from scanloom.cli.output import Output
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file
from scanloom.cli.scan_argument import ScanFolder, read_scan
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.stages import RefineParams, ScanParams


def refine(
    folder: ScanFolder,
    mesh_file: Annotated[
        Path,
        typer.Argument(
            metavar="MESH", help="Mesh file fused from this scan, after `clean`.", show_default=False
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Mesh file to write.", show_default=False)],
    scan: ScanParams,
    refine: RefineParams,
    out: Output,
) -> None:
    """Remove the noise of the sensor from a mesh.

    Walls and tables become planar, with straight creases; curved surfaces become smooth. No vertex moves
    farther than the measured noise justifies. The mesh must be in the coordinates of the scan's poses.

    Example: scanloom refine my_scan clean.ply refined.ply
    """
    require_new_file(target, MESH_SUFFIXES)
    mesh = read_mesh_file(mesh_file)
    source = read_scan(folder, scan)
    with out.progress("refine", "frames") as progress, locate_diagnostics(mesh_file):
        refined = stages.refine(mesh, source, refine, progress=progress)
    write_mesh_file(target, refined.mesh, out)
    metrics = refined.to_dict()
    warn_skipped_frames(metrics["frames_skipped"])
    out.result({"output": str(target), **metrics})
