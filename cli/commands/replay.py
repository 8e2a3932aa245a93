"""Command `replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import NewMesh, write_mesh_file
from scanloom.cli.output import Output
from scanloom.cli.paths import MESH_SUFFIXES, require_file, require_new_file
from scanloom.stages import ReplayParams


def replay(
    record: Annotated[
        Path,
        typer.Argument(
            metavar="RECORD", help="File (.npz) of scanloom simplify --save-record.", show_default=False
        ),
    ],
    target: NewMesh,
    replay: ReplayParams,
    out: Output,
) -> None:
    """Replay a simplification to a number of triangles.

    Example: scanloom mesh replay light.npz half.ply --ratio 0.5
    """
    require_new_file(target, MESH_SUFFIXES)
    replayed = stages.load_record(require_file(record)).replay(replay)
    write_mesh_file(target, replayed.mesh, out)
    metrics = {"triangles": len(replayed.mesh.triangles), "vertices": len(replayed.mesh.vertices)}
    out.result({"output": str(target), **metrics, "collapses": replayed.collapses})
