"""Command `bake`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom.cli.bake_output import TEXTURED_SUFFIXES, bake_and_write, format_bake
from scanloom.cli.mesh_arguments import read_mesh_file
from scanloom.cli.output import Output
from scanloom.cli.overlap import require_overlap
from scanloom.cli.paths import require_new_file
from scanloom.stages import BakeParams


def bake(
    light: Annotated[
        Path, typer.Argument(metavar="LIGHT", help="Mesh file that gets the texture.", show_default=False)
    ],
    original: Annotated[
        Path,
        typer.Argument(
            metavar="ORIGINAL", help="Detailed mesh file, with or without colours.", show_default=False
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Mesh file to write (.glb, .obj, .ply).", show_default=False),
    ],
    bake: BakeParams,
    out: Output,
) -> None:
    """Bake colours and details of a mesh for another.

    LIGHT keeps its triangles and is unwrapped into one or more images. Each texel gets the colour, the normal
    and the ambient occlusion of the nearest point of ORIGINAL that faces the same way. A GLB file holds the
    images; OBJ and PLY have separate image files, OUT-normal.png and OUT-occlusion.png. OUT-displacement.png
    is written with --set bake.displacement_map=true.

    Example: scanloom mesh bake light.ply clean.ply light.glb
    """
    require_new_file(target, TEXTURED_SUFFIXES)
    mesh, reference = read_mesh_file(light), read_mesh_file(original)
    metrics = {"output": str(target), **bake_and_write(target, mesh, reference, bake, out)}
    require_overlap(light, mesh, original, reference)
    out.result(metrics, format_bake(metrics))
