"""Command `compare`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from scanloom import stages
from scanloom.cli.comparison_text import comparison_text
from scanloom.cli.mesh_arguments import locate_diagnostics, read_mesh_or_cloud_file, write_mesh_file
from scanloom.cli.output import Output
from scanloom.cli.overlap import require_overlap
from scanloom.cli.page_params import PageParams
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file, require_writable
from scanloom.pipeline.report.comparison_page import make_comparison_page
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
from scanloom.stages.comparing.deviation_palette import colorize_distances
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.rendering.point_splats import make_point_splats
from scanloom.stages.rendering.render import RenderModel, write_png
from scanloom.stages.rendering.viewpoints import viewpoints
from scanloom.stages.surface.codes import COMPARE_POINT_CLOUD
from scanloom.stages.surface.mesh_files import GEOMETRY_ONLY_EXTENSIONS, set_default_up
from scanloom.stages.surface.point_cloud import is_cloud
from scanloom.stages.surface.raycasting import RaycastingSurface

# Formats that support the colours of --change.
COLORED_SUFFIXES = tuple(suffix for suffix in MESH_SUFFIXES if suffix not in GEOMETRY_ONLY_EXTENSIONS)
# Maximum number of drawn points of a cloud.
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
            help="Reference: a mesh or a point cloud (PLY, LAS, LAZ, E57).",
            show_default=False,
        ),
    ],
    other: Annotated[
        Path, typer.Argument(metavar="B", help="Mesh or point cloud to measure.", show_default=False)
    ],
    compare: CompareParams,
    deviation: DeviationParams,
    change: ChangeParams,
    views: ViewsParams,
    page: PageParams,
    out: Output,
    align: Annotated[
        str,
        typer.Option(
            "--align",
            metavar="none|icp",
            help="icp first aligns B with A rigidly; it needs a rough initial alignment. [default: none]",
            show_default=False,
        ),
    ] = "none",
    save_aligned: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Mesh file for B as aligned.", show_default=False),
    ] = None,
    save_ply: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="PLY file for B, coloured by deviation from A.", show_default=False
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture (.png) of the deviation.", show_default=False),
    ] = None,
    show_change: Annotated[
        bool, typer.Option("--change", help="Report new surface in B and removed surface of A, with areas.")
    ] = False,
    save_change: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Mesh file for --change: B in grey, new surface in green, removed surface in red.",
            show_default=False,
        ),
    ] = None,
    save_views: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder for pictures of A, B and their difference, from views.views viewpoints.",
            show_default=False,
        ),
    ] = None,
    page_file: Annotated[
        Path | None,
        typer.Option(
            "--page",
            metavar="FILE",
            help="Page (.html) that shows A, B, deviation and change.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Measure the deviation between meshes or point clouds.

    Reports distance (both ways) and colour difference (levels and ΔE2000), percentiles, the worst points, and
    the ratio within --tolerance. Deviations have a sign if A is oriented: positive in front of A. Relative
    distances refer to the diagonal of the bounding box of A. Distances to a cloud are those to its nearest
    point; distances to a surface are exact.

    --change is for two scans of one location: surface farther than change.change_distance from the other mesh
    is new or removed. Surface that the later scan did not observe counts as removed. views.views
    draws A and B and reports PSNR and SSIM of the pictures.

    The exit code is 1 if the distance between the meshes exceeds the size of the smaller one.

    Example: scanloom compare fused.ply simplified.ply --tolerance 0.002 --picture off.png

    Example: scanloom compare before.ply after.ply --align icp --change --set change.change_area=0.01
    """
    if align not in ("none", "icp"):
        raise UsageError(USAGE_OPTIONS_CONFLICT, "--align is {how!r}; it must be none or icp.", how=align)
    if save_aligned is not None:
        if align == "none":
            raise UsageError(
                USAGE_OPTIONS_CONFLICT, "--save-aligned needs --align icp; without it B is not moved."
            )
        require_new_file(save_aligned, MESH_SUFFIXES)
    if save_change is not None:
        if not show_change:
            raise UsageError(USAGE_OPTIONS_CONFLICT, "--save-change needs --change.")
        require_new_file(save_change, COLORED_SUFFIXES)
    # Pictures are drawn from six viewpoints if they are saved and no number is given.
    viewpoints = views.views or (6 if save_views is not None else 0)
    if save_views is not None:
        require_writable(save_views)
    for path, suffix in ((save_ply, ".ply"), (picture, ".png"), (page_file, ".html")):
        if path is not None:
            require_new_file(path, (suffix,))
    a, b = (set_default_up(path, read_mesh_or_cloud_file(path, out)) for path in (reference, other))
    _require_surfaces({"--change": show_change, "views.views": viewpoints > 0}, {reference: a, other: b})
    if save_aligned is not None and is_cloud(b):
        require_new_file(save_aligned, (".ply",))
    alignment = None
    if align == "icp":
        with locate_diagnostics(other), locate_diagnostics(reference, "reference"):
            b, alignment = stages.align(b, a)
    with locate_diagnostics(reference, "first mesh"), locate_diagnostics(other, "second mesh"):
        metrics = stages.compare(a, b, compare).to_dict()
    require_overlap(other, b, reference, a)
    found = stages.deviations(a, b, deviation)
    if save_aligned is not None:
        write_mesh_file(save_aligned, b, out)
    if save_ply is not None:
        write_mesh_file(save_ply, found.painted_mesh, out)
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        _write_picture(picture, found, deviation.palette)
    changed = stages.changes(a, b, change) if show_change else None
    if changed is not None and save_change is not None:
        write_mesh_file(save_change, changed.painted_mesh, out)
    drawn = stages.compare_views(a, b, replace(views, views=viewpoints)) if viewpoints else None
    if drawn is not None and save_views is not None:
        save_views.mkdir(parents=True, exist_ok=True)
        for one in drawn.scores:
            write_png(save_views / f"{one.name}.png", one.image)
    metrics |= {
        "change": None if changed is None else changed.to_dict(),
        "deviation": found.to_dict(),
        "alignment": None if alignment is None else alignment.to_dict(),
        "views": None if drawn is None else drawn.to_dict(),
    }
    if page_file is not None:
        names = reference.name, other.name
        content = make_comparison_page(
            names, (a, b), found, changed, metrics, page.max_bytes, deviation.palette
        )
        page_file.parent.mkdir(parents=True, exist_ok=True)
        with write_file_atomically(page_file) as draft:
            draft.write_bytes(content)
    out.result(metrics, None if out.as_json else comparison_text(metrics))


def _require_surfaces(wanted: dict[str, Any], read: dict[Path, Mesh]) -> None:
    """Refuse options that need two surfaces if one input is a point cloud."""
    for option, is_wanted in wanted.items():
        cloud = next((path for path, mesh in read.items() if is_cloud(mesh)), None)
        if is_wanted and cloud is not None:
            raise UsageError(
                COMPARE_POINT_CLOUD,
                "{option} needs two meshes, but {cloud} is a point cloud",
                remedy="leave it out.",
                option=option,
                cloud=cloud,
            )


def _write_picture(path: Path, found: Deviations, palette: str) -> None:
    """Write a picture of the deviations: the mesh from two sides and a colour scale."""
    painted = (
        make_point_splats(found.painted_mesh, _MAX_SPOTS)
        if is_cloud(found.painted_mesh)
        else found.painted_mesh
    )
    views = viewpoints(painted, 4, width=_VIEW_WIDTH)
    model = RenderModel(RaycastingSurface(painted))
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
    panel[top:bottom, 20 : 20 + _BAR] = colorize_distances(values, found.in_tolerance_limit, most, palette)[
        :, None
    ]
    cv2.putText(panel, "mm", (20, 32), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _INK, 1, cv2.LINE_AA)
    for value in np.linspace(most, lowest, _STEPS):
        row = round(top + (most - value) / (most - lowest) * (bottom - top - 1))
        text = f"{1000 * value:+.3g}" if found.is_signed else f"{1000 * value:.3g}"
        at = (20 + _BAR + 10, row + 6)
        cv2.putText(panel, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.55, _INK, 1, cv2.LINE_AA)
    return panel
