"""Commands `lod build`, `lod info` and `lod cut`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom.cli.bake_output import COLORS_ONLY, TEXTURED_SUFFIXES, bake_and_write, bake_or_warn, format_bake
from scanloom.cli.mesh_arguments import (
    MeshFile,
    NewMesh,
    locate_diagnostics,
    read_mesh_file,
    read_with_up,
    write_mesh_file,
)
from scanloom.cli.output import Output, format_size, format_table
from scanloom.cli.overlap import require_overlap
from scanloom.cli.paths import MESH_SUFFIXES, require_file, require_new_file
from scanloom.stages import UsageError
from scanloom.stages import lod as levels
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.lod import Hierarchy, LodParams
from scanloom.stages.normal_meshes.codes import LEVELS_LEVEL_MISSING
from scanloom.stages.params import check_parameters, param
from scanloom.stages.printing import format_upper_bound
from scanloom.stages.simplification.regions import parse_region

Slod = Annotated[
    Path, typer.Argument(metavar="FILE", help="Levels of detail (.slod) of lod build.", show_default=False)
]
Point = tuple[float, float, float]
_Y_AXIS = (0.0, 1.0, 0.0)
# Value of --texture for no texture.
NO_TEXTURE = "none"


@dataclass(frozen=True, kw_only=True)
class ViewParams:
    """View for which levels of detail are selected."""

    up: tuple[float, float, float] = param(_Y_AXIS, "Up direction of the picture.")
    width: int = param(1280, "Width of the picture.", unit="px", low=1)
    height: int = param(720, "Height of the picture.", unit="px", low=1)
    field_of_view: float = param(
        50.0, "Vertical angle of view.", unit="degrees", low=0, low_open=True, high=179
    )

    def __post_init__(self) -> None:
        check_parameters(self)


def build(
    source: MeshFile,
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write (.slod).", show_default=False)],
    lod: LodParams,
    out: Output,
) -> None:
    """Build levels of detail of a mesh.

    The levels form a tree of cells; the deviation of every level from the mesh is proven.

    Example: scanloom lod build clean.ply clean.slod
    """
    require_new_file(target, (".slod",))
    mesh = read_with_up(source)
    with locate_diagnostics(source), out.progress("lod", "triangles") as progress:
        hierarchy = levels.build(mesh, lod, progress=progress)
    target.parent.mkdir(parents=True, exist_ok=True)
    levels.write_slod(target, hierarchy)
    _print_levels(hierarchy, target, out)


def info(source: Slod, out: Output) -> None:
    """Print the levels of a file and their bounds.

    Example: scanloom lod info clean.slod
    """
    hierarchy = levels.read_slod(require_file(source))
    emit(*hierarchy.diagnostics)
    _print_levels(hierarchy, source, out)


def cut(
    source: Slod,
    target: NewMesh,
    view: ViewParams,
    out: Output,
    triangles: Annotated[
        int | None,
        typer.Option(metavar="COUNT", min=1, help="Maximum number of triangles.", show_default=False),
    ] = None,
    error_px: Annotated[
        float | None,
        typer.Option(
            metavar="PIXELS",
            min=0,
            help="Maximum proven error in the picture; needs --eye and --look.",
            show_default=False,
        ),
    ] = None,
    max_shape: Annotated[
        float | None,
        typer.Option(metavar="METRES", min=0, help="Maximum proven error in metres.", show_default=False),
    ] = None,
    eye: Annotated[
        Point | None, typer.Option(metavar="X Y Z", help="Position of the viewer, in m.", show_default=False)
    ] = None,
    look: Annotated[
        Point | None,
        typer.Option(metavar="X Y Z", help="Point in the middle of the picture, in m.", show_default=False),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(
            metavar="REGION",
            help='Refine only here: "sphere x y z radius" or "box x y z x y z", in m.',
            show_default=False,
        ),
    ] = None,
    texture: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL|none",
            help="Mesh file with the texture or vertex colours to bake into OUT (.glb, .obj, .ply), or "
            "none for vertex colours. Default: the mesh that the levels were built from, if it has a "
            "texture.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Extract a mesh for a view, size or error.

    A mesh with a texture gets a new image, if the format of OUT holds one.

    Example: scanloom lod cut clean.slod near.ply --eye 0 0 0 --look 0 0 1 --error-px 1
    """
    model_file = None if texture in (None, NO_TEXTURE) else Path(str(texture))
    require_new_file(target, MESH_SUFFIXES if model_file is None else TEXTURED_SUFFIXES)
    if (eye is None) != (look is None):
        raise UsageError(USAGE_OPTIONS_CONFLICT, "a viewpoint needs both --eye and --look.")
    camera = None
    if eye is not None and look is not None:
        camera = levels.View(eye, look, view.up, view.width, view.height, view.field_of_view)
    # `parse_region` requires an effect, which is not used here.
    where = None if region is None else parse_region(f"{region} lock")
    hierarchy = levels.read_slod(require_file(source))
    emit(*hierarchy.diagnostics)
    model = None if model_file is None else read_mesh_file(model_file)
    found = hierarchy.cut(camera, triangles=triangles, error_px=error_px, max_shape=max_shape, region=where)
    metrics = found.to_dict()
    if triangles is not None and metrics["triangles"] > triangles:
        emit(
            LEVELS_LEVEL_MISSING.unmet(
                "the coarsest level has {triangles:,} triangles.", source, triangles=metrics["triangles"]
            )
        )
    if max_shape is not None and metrics["shape_bound_m"] > max_shape:
        emit(
            LEVELS_LEVEL_MISSING.unmet(
                "the proven error of the finest level is {bound} m, which exceeds max_shape.",
                source,
                bound=format_upper_bound(metrics["shape_bound_m"]),
            )
        )
    baked = None
    if model_file is not None and model is not None:
        mesh = found.mesh if found.mesh.up is not None else found.mesh.with_(up=model.up)
        baked = bake_and_write(target, mesh, model, COLORS_ONLY, out)
        require_overlap(source, found.mesh, model_file, model)
    elif texture is None and hierarchy.model is not None and target.suffix.lower() in TEXTURED_SUFFIXES:
        baked = bake_or_warn(target, found.mesh, hierarchy.model, out)
    if baked is None:
        write_mesh_file(target, found.mesh, out)
    else:
        # The proven bound is of vertex colours; the error of the image is measured.
        metrics |= {"color_bound_levels": None, "texture": baked}
    text = _cut_text(metrics) + ("" if baked is None else f"\n\n{format_bake(baked)}")
    out.result(metrics, None if out.as_json else text)


def _print_levels(hierarchy: Hierarchy, path: Path, out: Output) -> None:
    metrics = hierarchy.to_dict() | {"bytes": path.stat().st_size}
    out.result(metrics, None if out.as_json else _text(metrics))


def _text(metrics: Mapping[str, Any]) -> str:
    rows = [["level", "cells", "triangles", "largest cell", "proven error m", "colour levels"]]
    for level in metrics["levels"]:
        color = level["color_bound_levels"]
        rows.append(
            [
                str(level["level"]),
                f"{level['nodes']:,}",
                f"{level['triangles']:,}",
                f"{level['largest_node_triangles']:,}",
                format_upper_bound(level["shape_bound_m"]),
                "" if color is None else format_upper_bound(color),
            ]
        )
    base = metrics["base_shape_bound_m"]
    rows.append(
        [
            "base",
            f"{metrics['leaves']:,}",
            f"{metrics['base_triangles']:,}",
            "",
            format_upper_bound(base) if base else "0",
            "",
        ]
    )
    text = (
        f"{format_table(rows)}\n\n{metrics['stored_triangles']:,} triangles stored for "
        f"{metrics['input_triangles']:,} input triangles, in {format_size(metrics['bytes'])}."
    )
    if metrics["one_sided"]:
        text += (
            f"\n{metrics['dropped_islands']:,} small components, {metrics['dropped_triangles']:,} triangles, "
            "were dropped. Bounds from the input to a level do not cover them."
        )
    return text


def _cut_text(metrics: Mapping[str, Any]) -> str:
    color = metrics["color_bound_levels"]
    proven = (
        "proven" if metrics["proven"] else "the bound of the next coarser level, not proven between levels"
    )
    if metrics["one_sided"]:
        proven += "; dropped components are not covered"
    colors = "" if color is None else f" and {format_upper_bound(color)} levels"
    return (
        f"{metrics['triangles']:,} triangles of {metrics['nodes']:,} cells, "
        f"within {format_upper_bound(metrics['shape_bound_m'])} m{colors}: {proven}."
    )
