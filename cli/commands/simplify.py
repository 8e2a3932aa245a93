"""The command `simplify`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

import stages
from cli.baked import TEXTURED_SUFFIXES, baked_text, baked_to
from cli.mesh_arguments import MeshFile, NewMesh, about_file, read_file, write_file
from cli.output import Output, lines_of
from cli.paths import MESH_SUFFIXES, require_new_file
from cli.written_bounds import SaveBounds, write_bounds
from stages import BakeParams, SimplifyParams, UsageError
from stages.printing import at_most
from stages.simplification.regions import parse_region


def simplify(
    source: MeshFile,
    target: NewMesh,
    params: SimplifyParams,
    out: Output,
    region: Annotated[
        list[str] | None,
        typer.Option(
            metavar="REGION",
            help='A place to take care of: "sphere x y z radius" or "box x y z x y z" (lowest, then highest '
            "corner), in m, followed by an importance (factor of the squared error there, or divisor of the "
            "bounds), by lock (nothing moves there), or by both. Can be given several times.",
            show_default=False,
        ),
    ] = None,
    save_record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Keep all collapses in this file (.npz), for scanloom replay.",
            show_default=False,
        ),
    ] = None,
    save_bounds: SaveBounds = None,
    bake: Annotated[
        bool,
        typer.Option(
            "--bake",
            help="Keep the colour in full: a texture with the colours of IN, as `scanloom bake` makes it, in "
            "place of vertex colours. OUT is then .glb, .obj or .ply.",
        ),
    ] = False,
    partial: Annotated[
        bool,
        typer.Option(
            "--partial",
            help="Ctrl-C writes what there is by then, instead of nothing; where bounds were given, after "
            "proving how far that is from IN.",
        ),
    ] = False,
) -> None:
    """Make a mesh light: collapse edges to a number of triangles, or within bounds on shape and colour.

    With --triangles or --ratio: to that number, with the least error.
    With --max-shape, --max-texture or both: as far as these are proven to hold at every point.
    With a number and bounds: down to the number, never beyond the bounds; "stopped by" says which came first.
    With neither: within the default bounds of --method jia01.

    --close-bounds and --save-bounds go with bounds. The input must be a manifold mesh; run `scanloom clean`
    on it first when it is not. Methods seams and planar take any mesh; auto takes seams for a model with
    texture, materials or parts.

    Example: scanloom simplify clean.ply light.ply --ratio 0.1

    Example: scanloom simplify model.glb light.glb --ratio 0.1

    Example: scanloom simplify clean.ply light.ply --ratio 0.1 --region "sphere 0 0 1.2 0.3 20"

    Example: scanloom simplify clean.ply light.ply --max-shape 0.005 --max-texture 20

    Example: scanloom simplify clean.ply light.ply --triangles 20000 --max-shape 0.005

    Example: scanloom simplify clean.ply light.glb --ratio 0.02 --bake
    """
    require_new_file(target, TEXTURED_SUFFIXES if bake else MESH_SUFFIXES)
    if save_record is not None:
        require_new_file(save_record, (".npz",))
    if save_bounds is not None:
        require_new_file(save_bounds, (".ply",))
        if params.chosen() != "certified":
            raise UsageError(
                "--save-bounds is for bounds that are proven; give --max-shape or --max-texture, and what "
                "leads to no other method than certified."
            )
    regions = [parse_region(text) for text in region or ()]
    mesh = read_file(source, out)
    with about_file(source), out.progress("simplify", "triangles") as progress:
        simplified = stages.simplify(
            mesh,
            params,
            regions=regions,
            record=save_record is not None,
            partial=partial,
            progress=progress,
        )
    baked = baked_to(target, simplified.mesh, mesh, BakeParams(), out) if bake else None
    if baked is None:
        write_file(target, simplified.mesh, out)
    if simplified.record is not None and save_record is not None:
        save_record.parent.mkdir(parents=True, exist_ok=True)
        simplified.record.save(save_record)
    if save_bounds is not None:
        write_bounds(save_bounds, simplified.mesh, simplified.shape_bound, simplified.color_bound, out)
    figures = {"output": str(target), **simplified.figures()}
    for warning in simplified.warnings:
        out.remark(f"warning: {warning}")
    text = lines_of(
        {name: value for name, value in figures.items() if name not in ("warnings", "largest_patches")}
    )
    if baked is not None:
        figures["baked"] = baked
        text += f"\n\n{baked_text(baked)}"
    out.result(figures, f"{text}\n\n{_proof_text(figures)}" if simplified.method == "certified" else text)


def _proof_text(figures: Mapping[str, Any]) -> str:
    """Say what is proven of a simplified mesh, and whether that is what was asked for."""
    most = f"{at_most(figures['shape_bound_m'])} m"
    if figures["color_bound_levels"] is not None:
        most += f" and {at_most(figures['color_bound_levels'])} levels"
    text = f"Proven: no point is more than {most} off."
    if figures["proven"]:
        return text
    own, original = figures["unproven_triangles"]
    return (
        f"{text}\nNot proven: the bounds that were asked for, at {own:,} triangles of the result and "
        f"{original:,} of the original."
    )
