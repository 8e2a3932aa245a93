"""The stage `fuse`: its mesh, the plane that was left out of it, and what could not be joined to it.

fused.ply
fused.pieces.json      which of it is of which piece, if it is large
plane.json             what is up from the plane that things stand on, if one was found and left out
pieces/fused-N.ply     frames that poses could not join to those that are used
"""

from __future__ import annotations

import json
from pathlib import Path

from pipeline import registering
from pipeline.standing import Up
from stages.errors import InputError, UsageError
from stages.files.documents import read_document
from stages.fusion.fuse import Fused, fuse, fuse_to_file
from stages.fusion.in_bricks import FusedInBricks, Kept
from stages.fusion.params import FuseParams
from stages.progress import Progress, silent
from stages.scans.scan import Scan
from stages.surface.formats.ply import write_ply

_PLANE = "plane.json"


def make(
    folder: Path, scan: Scan, params: FuseParams, kept: Kept | None, progress: Progress = silent
) -> Fused | FusedInBricks:
    """Fuse a scan, and write what comes out; `kept` has bricks of before."""
    fused = fuse_to_file(scan, params, folder / "fused.ply", kept=kept, progress=progress)
    if fused.support is not None:
        (folder / _PLANE).write_text(
            json.dumps({"up": fused.support.normal}) + "\n", encoding="utf-8", newline="\n"
        )
    return fused


def up_from_plane(folder: Path) -> Up | None:
    """Return what is up from the plane that was left out; None if none was."""
    if not (folder / _PLANE).exists():
        return None
    x, y, z = read_document(folder / _PLANE)["up"]
    return x, y, z


def fuse_apart(folder: Path, scan: Scan, posed: Path, params: FuseParams) -> list[str]:
    """Fuse the pieces that poses could not join to the one that is used, each into a mesh of its own.

    Returns what is to be said of them: each has a world of its own, in which no place is known.
    """
    said = []
    for number, piece in registering.apart(scan, posed).items():
        if params.box is not None or params.center is not None:
            said.append(f"piece {number} is not fused: where the box or the center is in it is not known")
            continue
        try:
            fused = fuse(piece, params)
        except (InputError, UsageError) as error:
            said.append(f"piece {number} is not fused: {error}")
            continue
        pieces = folder / "pieces"
        pieces.mkdir(exist_ok=True)
        write_ply(pieces / f"fused-{number}.ply", fused.mesh)
        said.append(
            f"piece {number}, of {len(piece.frames)} frames, is fused apart: pieces/fused-{number}.ply"
        )
        said += (f"piece {number}: {warning}" for warning in fused.warnings)
    return said
