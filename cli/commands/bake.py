"""The command `bake`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom.cli.baked import TEXTURED_SUFFIXES, baked_text, baked_to
from scanloom.cli.mesh_arguments import read_file
from scanloom.cli.output import Output
from scanloom.cli.overlap import require_overlap
from scanloom.cli.paths import require_new_file
from scanloom.stages import BakeParams


def bake(
    light: Annotated[
        Path, typer.Argument(metavar="LIGHT", help="Mesh file that gets the colours.", show_default=False)
    ],
    original: Annotated[
        Path,
        typer.Argument(
            metavar="ORIGINAL", help="Mesh file that has them: of vertices, or a texture.", show_default=False
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Mesh file to write (.glb, .obj, .ply).", show_default=False),
    ],
    params: BakeParams,
    out: Output,
) -> None:
    """Give a light mesh a texture that holds all the colour of its original.

    LIGHT keeps its triangles, and is laid out in an image, or in several where one is too small; every
    texel gets the colour of the original where it is nearest and faces the same way. GLB holds the images;
    OBJ and PLY have them in files beside them.

    Example: scanloom bake light.ply clean.ply light.glb
    """
    require_new_file(target, TEXTURED_SUFFIXES)
    mesh, reference = read_file(light), read_file(original)
    figures = {"output": str(target), **baked_to(target, mesh, reference, params, out)}
    require_overlap(light, mesh, original, reference)
    out.result(figures, baked_text(figures))
