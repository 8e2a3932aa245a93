"""Baking, writing what was baked, and telling of it: for the command `bake`, and after `simplify --bake`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import stages
from cli.mesh_arguments import write_file
from cli.output import Output, lines_of
from stages import BakeParams, Mesh

# Formats that hold texture coordinates and an image.
TEXTURED_SUFFIXES = (".glb", ".obj", ".ply")


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
