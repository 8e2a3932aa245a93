"""Command `view`."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from scanloom.cli.mesh_arguments import read_with_up
from scanloom.cli.output import Output
from scanloom.cli.page_params import PageParams
from scanloom.cli.paths import require_new_file
from scanloom.pipeline.report.page.folder_server import FolderServer
from scanloom.pipeline.report.page.tileset_page import make_tileset_page
from scanloom.pipeline.report.run_page import make_mesh_page, make_run_page
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.codes import FILE_PATH_INVALID
from scanloom.stages.lod.tiles import PAGE_INDEX, TILESET


def view(
    what: Annotated[
        Path,
        typer.Argument(
            metavar="WHAT",
            help="Mesh file, OUT of a run, or folder of lod tiles.",
            show_default=False,
        ),
    ],
    page: PageParams,
    out: Output,
    target: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write the page to a file (.html) that opens without a server, instead of showing it.",
            show_default=False,
        ),
    ] = None,
    port: Annotated[
        int, typer.Option(metavar="PORT", help="Port of the server; 0: any free port.", min=0, max=65535)
    ] = 0,
    open_browser: Annotated[
        bool | None,
        typer.Option(
            "--open/--no-open",
            help="Open the page in a browser. [default: if the output is a terminal]",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Show a mesh, a run or tiles in the browser.

    A run is shown with its result, the clean mesh, the deviation, and its stages, warnings and parameters.
    The server answers this machine only. Ctrl-C stops it.

    Example: scanloom view my_mesh

    Example: scanloom view model.glb -o model.html
    """
    if target is not None:
        require_new_file(target, (".html",))
    if not what.exists():
        raise InputError(FILE_PATH_INVALID, "there is no such file or folder.", what)
    is_tiles = (what / TILESET).is_file()
    if is_tiles and target is not None:
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "tiles cannot be written as a single file; lod tiles --page writes a page next to them.",
        )
    if is_tiles:
        _serve(what, make_tileset_page(), port, open_browser, out)
        return
    if what.is_dir():
        content = make_run_page(what, page.max_bytes)
    else:
        content = make_mesh_page(what, read_with_up(what), page.max_bytes)
    if target is None:
        with TemporaryDirectory(prefix="scanloom-") as empty:
            _serve(Path(empty), {PAGE_INDEX: content}, port, open_browser, out)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with write_file_atomically(target) as draft:
        draft.write_bytes(content)
    out.result({"output": str(target), "bytes": len(content)})


def _serve(folder: Path, pages: dict[str, bytes], port: int, open_browser: bool | None, out: Output) -> None:
    try:
        with FolderServer(folder, port, pages) as server:
            out.result({"address": server.address}, f"{server.address}  (stop with Ctrl-C)")
            if open_browser or (open_browser is None and sys.stdout.isatty()):
                webbrowser.open_new_tab(server.address)
            server.serve_forever()
    except KeyboardInterrupt:
        out.remark("Ended.")
