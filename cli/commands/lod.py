"""The commands on levels of detail: `lod build`, `lod info` and `lod cut`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom.cli.baked import TEXTURED_SUFFIXES, baked_or_told, baked_text, baked_to
from scanloom.cli.mesh_arguments import MeshFile, NewMesh, about_file, read_file, read_standing, write_file
from scanloom.cli.output import Output, size_of, table_of
from scanloom.cli.overlap import require_overlap
from scanloom.cli.paths import MESH_SUFFIXES, require_file, require_new_file
from scanloom.stages import BakeParams, UsageError, lod
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.lod import Hierarchy, LodParams
from scanloom.stages.normal_meshes.codes import LEVELS_LEVEL_MISSING
from scanloom.stages.printing import at_most
from scanloom.stages.simplification.regions import parse_region

Slod = Annotated[
    Path, typer.Argument(metavar="FILE", help="Levels of detail (.slod), from lod build.", show_default=False)
]
Point = tuple[float, float, float]


def build(
    source: MeshFile,
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write (.slod).", show_default=False)],
    params: LodParams,
    out: Output,
) -> None:
    """Build levels of detail: a tree of cells, every level of each proven against the mesh.

    Example: scanloom lod build clean.ply clean.slod
    """
    require_new_file(target, (".slod",))
    mesh = read_standing(source)
    with about_file(source), out.progress("lod", "triangles") as progress:
        hierarchy = lod.build(mesh, params, progress=progress)
    target.parent.mkdir(parents=True, exist_ok=True)
    lod.write_slod(target, hierarchy)
    _tell(hierarchy, target, out)


def info(source: Slod, out: Output) -> None:
    """Say what levels of detail a file has, and what is proven of each.

    Example: scanloom lod info clean.slod
    """
    hierarchy = lod.read_slod(require_file(source))
    emit(*hierarchy.diagnostics)
    _tell(hierarchy, source, out)


def cut(
    source: Slod,
    target: NewMesh,
    out: Output,
    triangles: Annotated[
        int | None,
        typer.Option(metavar="COUNT", min=1, help="At most so many triangles.", show_default=False),
    ] = None,
    error_px: Annotated[
        float | None,
        typer.Option(
            metavar="PIXELS",
            min=0,
            help="No more proven error than this in what is seen; asks for --eye and --look.",
            show_default=False,
        ),
    ] = None,
    max_shape: Annotated[
        float | None,
        typer.Option(metavar="METRES", min=0, help="No more proven error than this.", show_default=False),
    ] = None,
    eye: Annotated[
        Point | None, typer.Option(metavar="X Y Z", help="Where the eye is, in m.", show_default=False)
    ] = None,
    look: Annotated[
        Point | None,
        typer.Option(metavar="X Y Z", help="A point it looks straight at, in m.", show_default=False),
    ] = None,
    up: Annotated[Point, typer.Option(metavar="X Y Z", help="What is up in the picture.")] = (0.0, 1.0, 0.0),
    size: Annotated[tuple[int, int], typer.Option(metavar="WIDTH HEIGHT", help="Pixels of the picture.")] = (
        1280,
        720,
    ),
    field: Annotated[
        float, typer.Option(metavar="DEGREES", help="The angle that the picture's height spans.")
    ] = 50.0,
    region: Annotated[
        str | None,
        typer.Option(
            metavar="REGION",
            help='Refine here alone: "sphere x y z radius" or "box x y z x y z", in m.',
            show_default=False,
        ),
    ] = None,
    texture: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL",
            help="Mesh file of the same surface with a texture or vertex colours, of which the mesh gets an "
            "image, as with bake; OUT is .glb, .obj or .ply then. By default the one that the levels were "
            "built of, if that has a texture.",
            show_default=False,
        ),
    ] = None,
    image: Annotated[
        bool,
        typer.Option("--image/--no-image", help="Whether the mesh gets an image, where there is one to get."),
    ] = True,
) -> None:
    """Take a mesh out of levels of detail: for a view, a number of triangles or an error.

    What was built of a mesh with a texture gets its image anew, in a format that holds one.

    Example: scanloom lod cut clean.slod near.ply --eye 0 0 0 --look 0 0 1 --error-px 1
    """
    require_new_file(target, MESH_SUFFIXES if texture is None else TEXTURED_SUFFIXES)
    if (eye is None) != (look is None):
        raise UsageError(USAGE_OPTIONS_CONFLICT, "a view needs both --eye and --look.")
    if texture is not None and not image:
        raise UsageError(USAGE_VALUE_INVALID, "--texture asks for an image and --no-image for none.")
    view = None
    if eye is not None and look is not None:
        view = lod.View(eye, look, up, *size, field)
    # A region of simplify has an effect; here it only says where.
    place = None if region is None else parse_region(f"{region} lock")
    hierarchy = lod.read_slod(require_file(source))
    emit(*hierarchy.diagnostics)
    model = None if texture is None else read_file(texture)
    found = hierarchy.cut(view, triangles=triangles, error_px=error_px, max_shape=max_shape, region=place)
    figures = found.figures()
    if triangles is not None and figures["triangles"] > triangles:
        emit(
            LEVELS_LEVEL_MISSING.unmet(
                "the coarsest level has {triangles:,} triangles.", source, triangles=figures["triangles"]
            )
        )
    if max_shape is not None and figures["shape_bound_m"] > max_shape:
        emit(
            LEVELS_LEVEL_MISSING.unmet(
                "the finest level is proven within {bound} m alone.",
                source,
                bound=at_most(figures["shape_bound_m"]),
            )
        )
    baked = None
    if texture is not None and model is not None:
        mesh = found.mesh if found.mesh.up is not None else found.mesh.with_(up=model.up)
        baked = baked_to(target, mesh, model, BakeParams(), out)
        require_overlap(source, found.mesh, texture, model)
    elif image and hierarchy.model is not None and target.suffix.lower() in TEXTURED_SUFFIXES:
        baked = baked_or_told(target, found.mesh, hierarchy.model, out)
    if baked is None:
        write_file(target, found.mesh, out)
    else:
        # What is proven is of colours of vertices; the image has what is measured.
        figures |= {"color_bound_levels": None, "texture": baked}
    text = _cut_text(figures) + ("" if baked is None else f"\n\n{baked_text(baked)}")
    out.result(figures, None if out.as_json else text)


def _tell(hierarchy: Hierarchy, path: Path, out: Output) -> None:
    figures = hierarchy.figures() | {"bytes": path.stat().st_size}
    out.result(figures, None if out.as_json else _text(figures))


def _text(figures: Mapping[str, Any]) -> str:
    rows = [["level", "cells", "triangles", "largest cell", "proven within m", "levels of colour"]]
    for level in figures["levels"]:
        color = level["color_bound_levels"]
        rows.append(
            [
                str(level["level"]),
                f"{level['nodes']:,}",
                f"{level['triangles']:,}",
                f"{level['largest_node_triangles']:,}",
                at_most(level["shape_bound_m"]),
                "" if color is None else at_most(color),
            ]
        )
    base = figures["base_shape_bound_m"]
    rows.append(
        [
            "base",
            f"{figures['leaves']:,}",
            f"{figures['base_triangles']:,}",
            "",
            at_most(base) if base else "0",
            "",
        ]
    )
    text = (
        f"{table_of(rows)}\n\n{figures['stored_triangles']:,} triangles are kept for "
        f"{figures['input_triangles']:,} of the input, in {size_of(figures['bytes'])}."
    )
    if figures["one_sided"]:
        text += (
            f"\n{figures['dropped_islands']:,} loose pieces, of {figures['dropped_triangles']:,} triangles, "
            "were dropped: what is proven holds from each level to the input, and back from all else of it."
        )
    return text


def _cut_text(figures: Mapping[str, Any]) -> str:
    color = figures["color_bound_levels"]
    proven = "proven" if figures["proven"] else "of the next coarser level, between two that are proven"
    if figures["one_sided"]:
        proven += ", but for the loose pieces that were dropped"
    colors = "" if color is None else f" and {at_most(color)} levels"
    return (
        f"{figures['triangles']:,} triangles of {figures['nodes']:,} cells, "
        f"within {at_most(figures['shape_bound_m'])} m{colors}: {proven}."
    )
