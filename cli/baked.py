"""Baking, writing what was baked, and telling of it: for the command `bake`, and after `simplify --bake`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanloom import stages
from scanloom.cli.mesh_arguments import write_file
from scanloom.cli.output import Output, lines_of
from scanloom.stages import BakeParams, Mesh
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import ScanloomError
from scanloom.stages.texturing.codes import SIMPLIFY_IMAGES_NOT_BAKED

# Formats that hold texture coordinates and an image.
TEXTURED_SUFFIXES = (".glb", ".obj", ".ply")


def loses_image(light: Mesh, original: Mesh) -> bool:
    """Return whether the original has an image that the light mesh has not."""
    return _has_image(original) and not _has_image(light)


def _has_image(mesh: Mesh) -> bool:
    return mesh.texture is not None and bool(mesh.texture.images) and bool(mesh.texture.has_uvs().any())


def baked_by_default(target: Path, light: Mesh, original: Mesh, out: Output) -> dict[str, Any] | None:
    """Bake the image of an original anew where the light mesh has lost it, and the format has room for it.

    Returns the figures. None where there is nothing to bake, or it cannot be done, which is told: the mesh is
    still to be written then.
    """
    if target.suffix.lower() not in TEXTURED_SUFFIXES or not loses_image(light, original):
        return None
    return baked_or_told(target, light, original, out)


def baked_or_told(target: Path, light: Mesh, original: Mesh, out: Output) -> dict[str, Any] | None:
    """Bake as `baked_to` does; where that cannot be, say why: None, and the mesh is still to be written."""
    try:
        return baked_to(target, light, original, BakeParams(), out)
    except ScanloomError as error:
        emit(
            SIMPLIFY_IMAGES_NOT_BAKED.warning(
                "the image is left out; it could not be baked anew: {reason}", target, reason=str(error)
            )
        )
        return None


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
