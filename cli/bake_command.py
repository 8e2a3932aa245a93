"""The command `bake`, and what `simplify --bake` does after simplifying."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import stages
from cli.mesh_arguments import read_file, write_file
from cli.options import with_options
from cli.output import Output, lines_of
from cli.paths import require_new_file
from stages import BakeParams, Mesh

# Formats that hold texture coordinates and an image.
TEXTURED_SUFFIXES = (".glb", ".obj", ".ply")


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("bake", rich_help_panel="One stage at a time")(with_options(bake))


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

    LIGHT keeps its triangles, and is laid out in an image; every texel gets the colour of the original
    where it is nearest and faces the same way. GLB holds the image; OBJ and PLY have it in a file beside
    them.

    Example: scanloom bake light.ply clean.ply light.glb
    """
    require_new_file(target, TEXTURED_SUFFIXES)
    mesh, reference = read_file(light, out), read_file(original, out)
    figures = {"output": str(target), **baked_to(target, mesh, reference, params, out)}
    out.result(figures, baked_text(figures))


def baked_to(target: Path, light: Mesh, original: Mesh, params: BakeParams, out: Output) -> dict[str, Any]:
    """Bake, write the textured mesh, and return the figures."""
    with out.progress("bake", "rows") as progress:
        baked = stages.bake(light, original, params, progress=progress)
    write_file(target, baked.mesh, out)
    return baked.figures()


def baked_text(figures: dict[str, Any]) -> str:
    """Return the figures as lines, errors in words."""
    plain = {name: value for name, value in figures.items() if name not in ("color", "vertex_color")}
    text = f"{lines_of(plain)}\n\nColour error on the original: {_error(figures['color'])} with the texture"
    before = figures["vertex_color"]
    return text + (f", {_error(before)} with vertex colours." if before else ".")


def _error(color: dict[str, float | None]) -> str:
    psnr = color["psnr_db"]
    return "none" if psnr is None else f"{color['rmse_levels']:.3g} levels (PSNR {psnr:.1f} dB)"
