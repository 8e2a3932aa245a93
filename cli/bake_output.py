"""Bake textures, write the result, and print its metrics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanloom import stages
from scanloom.cli.mesh_arguments import write_mesh_file
from scanloom.cli.output import Output, format_lines
from scanloom.stages import BakeParams, Mesh
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import ScanloomError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.texturing.codes import SIMPLIFY_IMAGES_NOT_BAKED

# Formats that hold texture coordinates and an image.
TEXTURED_SUFFIXES = (".glb", ".obj", ".ply")
# For commands that only replace lost colours.
COLORS_ONLY = BakeParams(normal_map=False, occlusion_map=False)


def loses_image(light: Mesh, original: Mesh) -> bool:
    """Check if the simplified mesh has lost the image of the original."""
    return _has_image(original) and not _has_image(light)


def _has_image(mesh: Mesh) -> bool:
    return mesh.texture is not None and bool(mesh.texture.images) and bool(mesh.texture.has_uvs().any())


def bake_lost_image(target: Path, light: Mesh, original: Mesh, out: Output) -> dict[str, Any] | None:
    """Bake the original's image again if the simplified mesh lost it and the format supports images.

    Returns the metrics, or None if the mesh is still to be written.
    """
    if target.suffix.lower() not in TEXTURED_SUFFIXES or not loses_image(light, original):
        return None
    return bake_or_warn(target, light, original, out)


def bake_or_warn(target: Path, light: Mesh, original: Mesh, out: Output) -> dict[str, Any] | None:
    """Bake like `bake_and_write`; if baking fails, warn and return None."""
    try:
        return bake_and_write(target, light, original, COLORS_ONLY, out)
    except ScanloomError as error:
        emit(
            SIMPLIFY_IMAGES_NOT_BAKED.warning(
                "the image is left out; it could not be baked again: {reason}", target, reason=str(error)
            )
        )
        return None


def bake_and_write(
    target: Path, light: Mesh, original: Mesh, params: BakeParams, out: Output
) -> dict[str, Any]:
    """Bake, write the textured mesh and the maps that it cannot hold, and return the metrics."""
    with out.progress("bake", "rows") as progress:
        baked = stages.bake(light, original, params, progress=progress)
    write_mesh_file(target, baked.mesh, out)
    for name, data in baked.list_map_files(target.stem, target.suffix).items():
        with write_file_atomically(target.with_name(name)) as part:
            part.write_bytes(data)
    return baked.to_dict()


def format_bake(metrics: dict[str, Any]) -> str:
    """Return the metrics as lines, with the colour errors in a sentence."""
    left_out = ("color", "vertex_color", "maps", "shading_error_before", "shading_error_after")
    plain = {name: value for name, value in metrics.items() if name not in left_out}
    texts = [format_lines(plain)]
    if metrics["color"]:
        texts.append(format_color_errors(metrics))
    if metrics["shading_error_after"]:
        texts.append(f"Normal map: {format_shading_errors(metrics)}.")
    return "\n\n".join(texts)


def format_shading_errors(metrics: dict[str, Any]) -> str:
    """Return the shading errors without and with a normal map as a sentence."""
    before, after = metrics["shading_error_before"], metrics["shading_error_after"]
    return (
        f"shading error {after['median_deg']:.2f}° (median) and {after['p90_deg']:.1f}° (90 %), without the "
        f"map {before['median_deg']:.2f}° and {before['p90_deg']:.1f}°"
    )


def format_color_errors(metrics: dict[str, Any]) -> str:
    """Return the colour errors of a baked mesh as a sentence."""
    text = f"Colour error on the original: {_error(metrics['color'])} with the texture"
    before = metrics["vertex_color"]
    return text + (f", {_error(before)} with vertex colours." if before else ".")


def _error(color: dict[str, float | None]) -> str:
    psnr = color["psnr_db"]
    return "none" if psnr is None else f"{color['rmse_levels']:.3g} levels (PSNR {psnr:.1f} dB)"
