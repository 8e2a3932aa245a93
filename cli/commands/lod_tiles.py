"""Command `lod tiles`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom.cli.mesh_arguments import locate_diagnostics, read_mesh_file
from scanloom.cli.output import Output, format_size
from scanloom.cli.paths import require_file, require_writable
from scanloom.pipeline.report.page.tileset_page import write_tileset_page
from scanloom.stages import lod
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.atomic_folders import require_replaceable_folder
from scanloom.stages.lod import TileImageParams, TilesParams
from scanloom.stages.lod.tiles import TILESET, TILESET_DESCRIPTION, is_tileset
from scanloom.stages.params import param
from scanloom.stages.printing import format_upper_bound

# Value of --texture for no texture.
NO_TEXTURE = "none"


@dataclass(frozen=True, kw_only=True)
class AllTilesParams(TileImageParams, TilesParams):
    """3D Tiles, their images and their page."""

    page: bool = param(
        False, "Also write a page, index.html, that shows the tiles in a browser.", common=True
    )

    def __post_init__(self) -> None:
        TileImageParams.__post_init__(self)
        TilesParams.__post_init__(self)


def tiles(
    source: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="Levels of detail (.slod) of lod build.", show_default=False),
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUTDIR",
            help="Folder to write; a tileset of scanloom in it is replaced.",
            show_default=False,
        ),
    ],
    tiles: AllTilesParams,
    out: Output,
    texture: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL|none",
            help="Mesh file with the texture or vertex colours for the images of the tiles, or none for "
            "vertex colours. Default: the mesh that the levels were built from, if it has a texture.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write levels of detail as 3D Tiles 1.1.

    OUTDIR gets tileset.json and a GLB file for each tile; each geometricError is proven. Tiles get images
    with --texture, or if the levels were built from a mesh with a texture. --page adds a page that shows the
    tiles; scanloom view shows them, too.

    Example: scanloom lod tiles clean.slod clean_tiles --texture textured.glb
    """
    require_replaceable_folder(target, is_tileset, TILESET_DESCRIPTION)
    require_writable(target.parent)
    model_file = None if texture in (None, NO_TEXTURE) else Path(str(texture))
    hierarchy = lod.read_slod(require_file(source))
    emit(*hierarchy.diagnostics)
    model = None if model_file is None else read_mesh_file(model_file)
    if texture == NO_TEXTURE:
        hierarchy = replace(hierarchy, model_glb=None)
    with locate_diagnostics(model_file or source, "model"), out.progress("tiles", "tiles") as progress:
        written = lod.write_tiles(hierarchy, target, tiles, texture=model, images=tiles, progress=progress)
    if tiles.page:
        write_tileset_page(target)
    full = sum(image.is_coarser_than_requested for image in written.images)
    if full:
        out.remark(
            f"{target}: {full:,} images have coarser texels than requested, because their side is limited to "
            f"{tiles.image_side:,} texels (--set tiles.image_side)"
        )
    metrics = {"output": str(target / TILESET), **written.to_dict()}
    out.result(metrics, None if out.as_json else _text(metrics))


def _text(metrics: Mapping[str, Any]) -> str:
    return (
        f"{metrics['output']}: {metrics['tiles']:,} tiles, {format_size(metrics['total_bytes'])}; "
        f"the root {format_size(metrics['root_bytes'])}, the median {format_size(metrics['median_bytes'])}, "
        f"the largest {format_size(metrics['largest_bytes'])}.\n"
        f"Positions have {metrics['positions']}, on a grid of {metrics['grid_step_m']:.3g} m, which moves "
        f"them by at most {format_upper_bound(metrics['grid_displacement_m'])} m; each "
        "geometricError includes this."
        + ("" if metrics["images"] is None else f"\n{_images_text(metrics['images'])}")
    )


def _images_text(metrics: Mapping[str, Any]) -> str:
    width, height = metrics["root_size"]
    rms = metrics["color_rms_levels_sampled"]
    return (
        f"Of that, images are {format_size(metrics['total_bytes'])}: the median "
        f"{format_size(metrics['median_bytes'])}, the root's {format_size(metrics['root_bytes'])} of "
        f"{width} × {height} texels; a texel is {metrics['finest_texel_m']:.3g} to "
        f"{metrics['coarsest_texel_m']:.3g} m wide.\n"
        f"Colours differ from the model's by {rms['median']:.3g} levels RMS in the median tile and "
        f"{rms['largest']:.3g} in the worst, as sampled."
    )
