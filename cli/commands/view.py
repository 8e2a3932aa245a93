"""The command `view`."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from cli.output import Output
from stages.errors import InputError
from stages.lod.tiles import TILESET
from stages.picturing.page.files import tiles_page
from stages.picturing.page.serving import FolderServer


def view(
    folder: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="Folder of tiles, from lod tiles.", show_default=False)
    ],
    out: Output,
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
    """Show tiles in the browser, from a server that answers this machine alone.

    Nothing is written: tiles without a page are shown with the one of scanloom. Ctrl-C ends it.

    Example: scanloom view clean_tiles
    """
    if not folder.is_dir():
        raise InputError("there is no such folder; give one that lod tiles made.", folder)
    if not (folder / TILESET).is_file():
        raise InputError(f"this folder has no {TILESET}; give one that lod tiles made.", folder)
    try:
        with FolderServer(folder, port, tiles_page()) as server:
            out.result({"address": server.address}, f"{server.address}  (Ctrl-C ends it)")
            if open_browser or (open_browser is None and sys.stdout.isatty()):
                webbrowser.open_new_tab(server.address)
            server.serve_forever()
    except KeyboardInterrupt:
        out.remark("Ended.")
