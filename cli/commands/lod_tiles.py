"""The command `lod tiles`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom.cli.mesh_arguments import about_file, read_file
from scanloom.cli.output import Output, size_of
from scanloom.cli.paths import require_file, require_writable
from scanloom.pipeline.report.page.files import write_tiles_page
from scanloom.stages import UsageError, lod
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.replacing_folder import require_replaceable_folder
from scanloom.stages.lod import TileImageParams, TilesParams
from scanloom.stages.lod.tiles import TILESET, WHAT, is_tileset
from scanloom.stages.printing import at_most


def tiles(
    source: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="Levels of detail (.slod), from lod build.", show_default=False),
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUTDIR",
            help="Folder to make; if it holds a tileset of scanloom, that is replaced.",
            show_default=False,
        ),
    ],
    params: TilesParams,
    images: TileImageParams,
    out: Output,
    texture: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL",
            help="Mesh file of the same surface with a texture or vertex colours: tiles get images of these. "
            "By default the one that the levels were built of, if that has a texture.",
            show_default=False,
        ),
    ] = None,
    image: Annotated[
        bool,
        typer.Option("--image/--no-image", help="Whether tiles get images, where there are any to get."),
    ] = True,
    page: Annotated[
        bool,
        typer.Option(
            "--page/--no-page",
            help="Write a page beside the tiles, index.html and what it needs, that draws them in a browser.",
        ),
    ] = False,
) -> None:
    """Write levels of detail as 3D Tiles 1.1, which viewers in the browser load by what they show.

    OUTDIR gets tileset.json and a GLB file for each tile. A tile's geometricError is proven. With --texture,
    or of a mesh with a texture, each tile has an image of its own, in place of vertex colours; with --page
    OUTDIR gets a page too, which draws them; scanloom view shows it.

    Example: scanloom lod tiles clean.slod clean_tiles --texture textured.glb
    """
    require_replaceable_folder(target, is_tileset, WHAT)
    require_writable(target.parent)
    if texture is not None and not image:
        raise UsageError(USAGE_VALUE_INVALID, "--texture asks for images and --no-image for none.")
    hierarchy = lod.read_slod(require_file(source))
    emit(*hierarchy.diagnostics)
    model = None if texture is None else read_file(texture)
    if not image:
        hierarchy = replace(hierarchy, model_glb=None)
    with about_file(texture or source, "model"), out.progress("tiles", "tiles") as progress:
        written = lod.write_tiles(hierarchy, target, params, texture=model, images=images, progress=progress)
    if page:
        write_tiles_page(target)
    full = sum(image.is_full for image in written.images)
    if full:
        out.remark(
            f"{target}: {full:,} images have coarser texels than was asked for, as no side is longer than "
            f"{images.image_side:,} texels; see --image-side"
        )
    figures = {"output": str(target / TILESET), **written.figures()}
    out.result(figures, None if out.as_json else _text(figures))


def _text(figures: Mapping[str, Any]) -> str:
    return (
        f"{figures['output']}: {figures['tiles']:,} tiles, {size_of(figures['total_bytes'])}; "
        f"the root {size_of(figures['root_bytes'])}, the median {size_of(figures['median_bytes'])}, "
        f"the largest {size_of(figures['largest_bytes'])}.\n"
        f"Positions have {figures['positions']}, on a grid of {figures['grid_step_m']:.3g} m, which moves "
        f"them by at most {at_most(figures['grid_share_m'])} m; this is in each geometricError."
        + ("" if figures["images"] is None else f"\n{_images_text(figures['images'])}")
    )


def _images_text(figures: Mapping[str, Any]) -> str:
    width, height = figures["root_size"]
    rms = figures["color_rms_levels_sampled"]
    return (
        f"Of that, images are {size_of(figures['total_bytes'])}: the median "
        f"{size_of(figures['median_bytes'])}, the root's {size_of(figures['root_bytes'])} of "
        f"{width} × {height} texels; a texel is {figures['finest_texel_m']:.3g} to "
        f"{figures['coarsest_texel_m']:.3g} m wide.\n"
        f"Colours differ from the model's by {rms['median']:.3g} levels RMS in the median tile and "
        f"{rms['largest']:.3g} in the worst, as sampled."
    )
