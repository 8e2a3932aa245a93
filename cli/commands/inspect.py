"""Command `inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.output import Output
from scanloom.cli.paths import require_new_file, require_scan
from scanloom.cli.rendering import as_typed
from scanloom.cli.scan_argument import ScanFolder
from scanloom.stages import ScanParams
from scanloom.stages.diagnostics.collector import listen_to_diagnostics
from scanloom.stages.inspecting.overview_image import draw_inspection
from scanloom.stages.rendering.render import write_png


def inspect(
    folder: ScanFolder,
    scan: ScanParams,
    out: Output,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Picture (.png) to write: camera positions from above and from the side, and depth over "
            "colour.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Describe a scan folder and its problems.

    Prints layout, frames, sizes, calibration, poses and depth, and warns about problems that would degrade a
    mesh.

    Example: scanloom inspect my_scan --picture my_scan.png
    """
    if picture is not None:
        require_new_file(picture, (".png",))
    # The diagnostics are printed with the result.
    with listen_to_diagnostics(out.count, forward=False):
        source = stages.read_scan(require_scan(folder), scan, complete=False)
        inspection = stages.inspect(source)
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        write_png(picture, draw_inspection(source))
    out.result(inspection.to_dict(), as_typed("\n".join(inspection.format_lines())))
