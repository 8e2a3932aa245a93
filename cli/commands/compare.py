"""The command `compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from scanloom import stages
from scanloom.cli.comparison_text import comparison_text
from scanloom.cli.mesh_arguments import about_file, read_file_or_cloud, write_file
from scanloom.cli.output import Output
from scanloom.cli.overlap import require_overlap
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file, require_writable
from scanloom.pipeline.report.comparison_page import page_of_comparison
from scanloom.stages import (
    ChangeParams,
    CompareParams,
    DeviationParams,
    Deviations,
    Mesh,
    UsageError,
    ViewsParams,
)
from scanloom.stages._opencv import require_opencv
from scanloom.stages.comparing.palette import colors_of
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.files.replacing import replacing
from scanloom.stages.picturing.render import Model, write_png
from scanloom.stages.picturing.spots import spots
from scanloom.stages.picturing.viewpoints import viewpoints
from scanloom.stages.surface.cloud import is_cloud
from scanloom.stages.surface.codes import COMPARE_POINT_CLOUD
from scanloom.stages.surface.mesh_files import SHAPE_ALONE, standing
from scanloom.stages.surface.raycasting import Surface

# Formats that keep the colours of a change.
COLORED_SUFFIXES = tuple(suffix for suffix in MESH_SUFFIXES if suffix not in SHAPE_ALONE)
# Points of a cloud that are drawn.
_MAX_SPOTS = 400_000
# The picture of deviations, px: each view, the bar of colours, and the scale that the bar is part of.
_VIEW_WIDTH, _BAR, _SCALE_WIDTH = 1000, 28, 200
_INK, _PAPER = (40, 44, 52), 250
_STEPS = 9


def compare(
    reference: Annotated[
        Path,
        typer.Argument(
            metavar="A",
            help="File to measure against: a mesh, or a cloud (PLY, LAS, LAZ, E57).",
            show_default=False,
        ),
    ],
    other: Annotated[
        Path, typer.Argument(metavar="B", help="File to measure: a mesh, or a cloud.", show_default=False)
    ],
    params: CompareParams,
    told: DeviationParams,
    changed: ChangeParams,
    seen: ViewsParams,
    out: Output,
    how: Annotated[
        str,
        typer.Option(
            "--align",
            metavar="WAY",
            help="`icp` moves B onto A first, rigidly, if it lies there roughly, and tells how. Or `none`.",
        ),
    ] = "none",
    save_aligned: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Mesh file for B as it was moved.", show_default=False),
    ] = None,
    save_ply: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="PLY file for B in the colours of its deviation from A.", show_default=False
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="PNG file for a picture of that and its scale.", show_default=False
        ),
    ] = None,
    change: Annotated[
        bool, typer.Option("--change", help="Tell what is new in B, and what of A is gone, with areas.")
    ] = False,
    save_change: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Mesh file for that: B in grey, what is new in green, what is gone in red.",
            show_default=False,
        ),
    ] = None,
    save_views: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder for the pictures of --views: A, B and their difference side by side.",
            show_default=False,
        ),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Page for A, B, the deviation and the change (.html), which opens without a network.",
            show_default=False,
        ),
    ] = None,
    page_size: Annotated[
        float, typer.Option(help="Megabytes that the page may take; models are made lighter for it.", min=1.2)
    ] = 5.0,
) -> None:
    """Measure how far two meshes are apart, or a mesh and a cloud of points, in shape and in colour.

    Where A is oriented, the deviations of B from it have signs: positive on the side that A looks to. Of them
    percentiles are told, the worst places, and what share is within --tolerance; colours also as ΔE2000.
    Distances to a cloud are to its nearest point, which its spacing limits; those to a surface are exact.

    --change is for two scans of one place: what is farther from the other mesh than --change-distance is new,
    or gone. What the later scan did not see counts as gone. --views draws both from all around, and tells how
    alike the pictures are, as PSNR and SSIM.

    Meshes that lie apart by more than the smaller one's size are not of one thing: the exit code is then 1.
    Relative distances refer to the diagonal of the bounding box of A.

    Example: scanloom compare fused.ply simplified.ply --json
    """
    if how not in ("none", "icp"):
        raise UsageError(USAGE_OPTIONS_CONFLICT, "--align is {how!r}; it must be none or icp.", how=how)
    if save_aligned is not None:
        if how == "none":
            raise UsageError(
                USAGE_OPTIONS_CONFLICT, "--save-aligned needs --align icp: nothing is moved without it."
            )
        require_new_file(save_aligned, MESH_SUFFIXES)
    if save_change is not None:
        if not change:
            raise UsageError(USAGE_OPTIONS_CONFLICT, "--save-change needs --change.")
        require_new_file(save_change, COLORED_SUFFIXES)
    if save_views is not None:
        if seen.views == 0:
            raise UsageError(USAGE_OPTIONS_CONFLICT, "--save-views needs --views: none are drawn without it.")
        require_writable(save_views)
    for path, suffix in ((save_ply, ".ply"), (picture, ".png"), (page, ".html")):
        if path is not None:
            require_new_file(path, (suffix,))
    a, b = (standing(path, read_file_or_cloud(path, out)) for path in (reference, other))
    _require_surfaces({"--change": change, "--views": seen.views > 0}, {reference: a, other: b})
    if save_aligned is not None and is_cloud(b):
        require_new_file(save_aligned, (".ply",))
    alignment = None
    if how == "icp":
        with about_file(other), about_file(reference, "reference"):
            b, alignment = stages.align(b, a)
    with about_file(reference, "first mesh"), about_file(other, "second mesh"):
        figures = stages.compare(a, b, params).figures()
    require_overlap(other, b, reference, a)
    found = stages.deviations(a, b, told)
    if save_aligned is not None:
        write_file(save_aligned, b, out)
    if save_ply is not None:
        write_file(save_ply, found.painted, out)
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        _write_picture(picture, found, told.palette)
    moved = stages.changes(a, b, changed) if change else None
    if moved is not None and save_change is not None:
        write_file(save_change, moved.painted, out)
    views = stages.compare_views(a, b, seen) if seen.views else None
    if views is not None and save_views is not None:
        save_views.mkdir(parents=True, exist_ok=True)
        for one in views.scores:
            write_png(save_views / f"{one.name}.png", one.picture)
    figures |= {
        "change": None if moved is None else moved.figures(),
        "deviation": found.figures(),
        "alignment": None if alignment is None else alignment.figures(),
        "views": None if views is None else views.figures(),
    }
    if page is not None:
        names = reference.name, other.name
        most_bytes = int(1e6 * page_size)
        content = page_of_comparison(names, (a, b), found, moved, figures, most_bytes, told.palette)
        page.parent.mkdir(parents=True, exist_ok=True)
        with replacing(page) as draft:
            draft.write_bytes(content)
    out.result(figures, None if out.as_json else comparison_text(figures))


def _require_surfaces(wanted: dict[str, Any], read: dict[Path, Mesh]) -> None:
    """Refuse options that a cloud has no answer to."""
    for option, is_wanted in wanted.items():
        cloud = next((path for path, mesh in read.items() if is_cloud(mesh)), None)
        if is_wanted and cloud is not None:
            raise UsageError(
                COMPARE_POINT_CLOUD,
                "{option} needs two surfaces, and {cloud} is a cloud of points",
                remedy="leave it out.",
                option=option,
                cloud=cloud,
            )


def _write_picture(path: Path, found: Deviations, palette: str) -> None:
    """Write a picture of the deviations: the mesh from two sides and a colour scale."""
    painted = spots(found.painted, _MAX_SPOTS) if is_cloud(found.painted) else found.painted
    views = viewpoints(painted, 4, width=_VIEW_WIDTH)
    model = Model(Surface(painted))
    drawn = [model.draw(view, "color") for view in (views[0], views[2])]
    height = drawn[0].shape[0]
    write_png(path, np.ascontiguousarray(np.hstack([*drawn, _draw_scale(found, palette, height)])))


def _draw_scale(found: Deviations, palette: str, height: int) -> NDArray[np.uint8]:
    require_opencv()
    import cv2

    panel = np.full((height, _SCALE_WIDTH, 3), _PAPER, np.uint8)
    top, bottom = 50, height - 30
    most, lowest = found.color_range, -found.color_range if found.is_signed else 0.0
    values = np.linspace(most, lowest, bottom - top)
    panel[top:bottom, 20 : 20 + _BAR] = colors_of(values, found.within, most, palette)[:, None]
    cv2.putText(panel, "mm", (20, 32), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _INK, 1, cv2.LINE_AA)
    for value in np.linspace(most, lowest, _STEPS):
        row = round(top + (most - value) / (most - lowest) * (bottom - top - 1))
        text = f"{1000 * value:+.3g}" if found.is_signed else f"{1000 * value:.3g}"
        at = (20 + _BAR + 10, row + 6)
        cv2.putText(panel, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.55, _INK, 1, cv2.LINE_AA)
    return panel
