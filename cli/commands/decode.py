"""Command `decode`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import NewMesh
from scanloom.cli.normal_mesh_output import SaveLevels, print_normal_mesh, write_normal_mesh
from scanloom.cli.output import Output
from scanloom.cli.paths import MESH_SUFFIXES, require_file, require_new_file, require_writable
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.lod.codes import LEVELS_FILE_DAMAGED


def decode(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="File (.snm) of scanloom mesh remesh --save.", show_default=False
        ),
    ],
    target: NewMesh,
    out: Output,
    level: Annotated[
        int | None,
        typer.Option(
            metavar="LEVEL",
            help="Level to write; 0 is the base mesh. Default: the finest.",
            show_default=False,
        ),
    ] = None,
    save_levels: SaveLevels = None,
) -> None:
    """Decode a level of a normal mesh.

    The mesh is bit-identical to the result of `scanloom mesh remesh`. If the file is damaged or truncated,
    the intact levels can still be decoded, with a warning.

    Example: scanloom mesh decode normal.snm coarse.ply --level 2
    """
    require_new_file(target, MESH_SUFFIXES)
    if save_levels is not None:
        require_writable(save_levels)
    found = stages.decode(require_file(source), level)
    if found.damage is not None:
        emit(
            LEVELS_FILE_DAMAGED.warning(
                "only levels 0 to {level} are intact: {damage}",
                source,
                level=len(found.offsets),
                damage=found.damage,
            )
        )
    write_normal_mesh(target, found, save_levels, out)
    print_normal_mesh(target, found, out)
