"""The scan folder that a command is given."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ScanFolder = Annotated[
    Path,
    typer.Argument(
        metavar="SCAN",
        help="Folder of the scan, or a recording (.bag, .db3, .sens, .r3d).",
        show_default=False,
    ),
]
