"""The command `view`."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from scanloom.cli.mesh_arguments import read_standing
from scanloom.cli.output import Output
from scanloom.cli.paths import require_new_file
from scanloom.pipeline.report.page.files import tiles_page
from scanloom.pipeline.report.page.serving import FolderServer
from scanloom.pipeline.report.run_page import page_of_mesh, page_of_run
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.codes import FILE_PATH_INVALID
from scanloom.stages.files.replacing import replacing
from scanloom.stages.lod.tiles import PAGE_INDEX, TILESET


def view(
    what: Annotated[
        Path,
        typer.Argument(
            metavar="WHAT",
            help="Mesh file, the OUT of a run, or a folder of tiles, from lod tiles.",
            show_default=False,
        ),
    ],
    out: Output,
    target: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write the page to this file (.html), which opens without a server or a network.",
            show_default=False,
        ),
    ] = None,
    page_size: Annotated[
        float, typer.Option(help="Megabytes that a page may take; models are made lighter for it.", min=1.2)
    ] = 5.0,
    port: Annotated[int, typer.Option(help="Port to listen on; 0 for a free one.", min=0, max=65535)] = 0,
    open_browser: Annotated[
        bool | None,
        typer.Option(
            "--open/--no-open",
            help="Open the page in a browser; if not given, where the output is a terminal.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Show a mesh, a run's results or tiles in the browser, from a server that answers this machine alone.

    Of a run the page shows the result, the clean mesh it came from and how far it deviates, with one camera
    for all, and tells stages, warnings and parameters. Nothing is written without -o. Ctrl-C ends it.

    Example: scanloom view my_mesh -o my_mesh/report.html
    """
    if target is not None:
        require_new_file(target, (".html",))
    if not what.exists():
        raise InputError(FILE_PATH_INVALID, "there is no such file or folder.", what)
    is_tiles = (what / TILESET).is_file()
    if is_tiles and target is not None:
        raise UsageError(
            USAGE_OPTIONS_CONFLICT, "tiles are many files; lod tiles --page writes their page beside them."
        )
    if is_tiles:
        _serve(what, tiles_page(), port, open_browser, out)
        return
    most_bytes = int(1e6 * page_size)
    if what.is_dir():
        page = page_of_run(what, most_bytes)
    else:
        page = page_of_mesh(what.resolve().stem, read_standing(what), most_bytes)
    if target is None:
        with TemporaryDirectory(prefix="scanloom-") as empty:
            _serve(Path(empty), {PAGE_INDEX: page}, port, open_browser, out)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with replacing(target) as draft:
        draft.write_bytes(page)
    out.result({"output": str(target), "bytes": len(page)})


def _serve(folder: Path, pages: dict[str, bytes], port: int, open_browser: bool | None, out: Output) -> None:
    try:
        with FolderServer(folder, port, pages) as server:
            out.result({"address": server.address}, f"{server.address}  (Ctrl-C ends it)")
            if open_browser or (open_browser is None and sys.stdout.isatty()):
                webbrowser.open_new_tab(server.address)
            server.serve_forever()
    except KeyboardInterrupt:
        out.remark("Ended.")
