"""Commands on mesh files: clean, simplify, replay, patches, compare, certify, render."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import stages
from cli.bake_command import TEXTURED_SUFFIXES, baked_text, baked_to
from cli.errors import STAGE_FAILED
from cli.mesh_arguments import MeshFile, NewMesh, about_file, read_file, tell_written, write_file
from cli.options import with_options
from cli.output import Output, at_least, at_most, lines_of, table_of
from cli.paths import MESH_SUFFIXES, require_file, require_new_file
from stages import (
    BakeParams,
    CertifyParams,
    CleanParams,
    CompareParams,
    Mesh,
    PatchParams,
    ReplayParams,
    SimplifyParams,
    UsageError,
)
from stages.params import check, param
from stages.picturing.render import write_png
from stages.simplification.planar.patches import colored_by_patch
from stages.simplification.regions import parse_region
from stages.surface.formats.ply import write_ply

SaveBounds = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="PLY file for the mesh with what is proven of each triangle, as properties of its face: "
        "shape_bound in m, color_bound in 8-bit levels. It may be the mesh file itself.",
        show_default=False,
    ),
]


@dataclass(frozen=True, kw_only=True)
class PictureParams:
    """How a picture of a mesh is taken."""

    view: int = param(1, "Which of the views around the mesh, counted from 1.", low=1, high=8)
    width: int = param(1200, "Width of the picture.", unit="px", low=16, high=8192)
    shading: str = param(
        "color",
        "Vertex colours, plain clay that shows the shape, or clay with the edges of the triangles.",
        choices=("color", "plain", "edges"),
    )

    def __post_init__(self) -> None:
        check(self)


def add_to(app: typer.Typer) -> None:
    """Register the commands."""
    app.command("clean", rich_help_panel="One stage at a time")(with_options(clean))
    app.command("simplify", rich_help_panel="One stage at a time")(with_options(simplify))
    app.command("replay", rich_help_panel="One stage at a time")(with_options(replay))
    app.command("patches", rich_help_panel="Look and measure")(with_options(patches))
    app.command("compare", rich_help_panel="Look and measure")(with_options(compare))
    app.command("certify", rich_help_panel="Look and measure")(with_options(certify))
    app.command("render", rich_help_panel="Look and measure")(with_options(render))


def clean(source: MeshFile, target: NewMesh, params: CleanParams, out: Output) -> None:
    """Remove what a mesh should not have: islands, degenerate, duplicate and non-manifold parts.

    What comes out is an oriented manifold; colours survive. OUT may be IN: it is replaced in one step.

    Example: scanloom clean fused.ply clean.ply
    """
    require_new_file(target, MESH_SUFFIXES)
    mesh = read_file(source, out)
    with about_file(source):
        cleaned = stages.clean(mesh, params)
    write_file(target, cleaned.mesh, out)
    out.result({"output": str(target), **cleaned.figures()})


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
        _write_bounds(save_bounds, simplified.mesh, simplified.shape_bound, simplified.color_bound, out)
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


def replay(
    record: Annotated[
        Path,
        typer.Argument(
            metavar="RECORD", help="File that `simplify --save-record` wrote.", show_default=False
        ),
    ],
    target: NewMesh,
    params: ReplayParams,
    out: Output,
) -> None:
    """Write a mesh as it was on the way of a simplification, at any number of triangles.

    Example: scanloom replay light.npz half.ply --ratio 0.5
    """
    require_new_file(target, MESH_SUFFIXES)
    replayed = stages.load_record(require_file(record)).replay(params)
    write_file(target, replayed.mesh, out)
    figures = {"triangles": len(replayed.mesh.triangles), "vertices": len(replayed.mesh.vertices)}
    out.result({"output": str(target), **figures, "collapses": replayed.collapses})


def patches(source: MeshFile, target: NewMesh, params: PatchParams, out: Output) -> None:
    """Find the near-planar patches of a mesh, its walls and floors, and write it coloured by them.

    These are what `scanloom simplify --method planar` triangulates anew, but that it divides a patch that
    lies over itself, seen along its normal. In a PLY, each face also has the number of its patch; patches are
    numbered by area, largest first.

    Example: scanloom patches clean.ply patches.ply --max-shape 0.02
    """
    require_new_file(target, MESH_SUFFIXES)
    mesh = read_file(source, out)
    with about_file(source), out.progress("patches", "triangles") as progress:
        found = stages.planar_patches(mesh, params, progress=progress)
    colored = colored_by_patch(mesh, found.triangle_patch)
    if target.suffix.lower() == ".ply":
        kept = found.triangle_patch[found.triangle_patch >= 0]
        target.parent.mkdir(parents=True, exist_ok=True)
        write_ply(target, colored, {"patch": kept.astype(np.float64)})
        tell_written(target, colored, out)
    else:
        write_file(target, colored, out)
    figures = {"output": str(target), **found.figures()}
    out.result(figures, None if out.as_json else _patches_text(figures))


def compare(
    reference: Annotated[
        Path, typer.Argument(metavar="A", help="Mesh file to measure against.", show_default=False)
    ],
    other: Annotated[Path, typer.Argument(metavar="B", help="Mesh file to measure.", show_default=False)],
    params: CompareParams,
    out: Output,
) -> None:
    """Measure how far two meshes are apart, in shape (both ways) and in colour.

    Relative distances refer to the diagonal of the bounding box of A.

    Example: scanloom compare fused.ply simplified.ply --json
    """
    mesh_a, mesh_b = read_file(reference, out), read_file(other, out)
    figures = stages.compare(mesh_a, mesh_b, params).figures()
    out.result(figures, None if out.as_json else _comparison_text(figures))


def certify(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Mesh file to prove something of.", show_default=False)
    ],
    original: Annotated[
        Path, typer.Argument(metavar="ORIGINAL", help="Mesh file it came from.", show_default=False)
    ],
    params: CertifyParams,
    out: Output,
    save_bounds: SaveBounds = None,
) -> None:
    """Prove how far a mesh is from its original at most, in shape (both ways) and in colour, at any point.

    With --max-shape or --max-color it is only found out whether they are kept; the exit code is 1 if that is
    not proven.

    Example: scanloom certify simplified.ply clean.ply --max-shape 0.005 --max-color 20
    """
    if save_bounds is not None:
        require_new_file(save_bounds, (".ply",))
    mesh, reference = read_file(result, out), read_file(original, out)
    with out.progress("certify", "pieces") as progress:
        found = stages.certify(mesh, reference, params, progress=progress)
    if save_bounds is not None:
        _write_bounds(save_bounds, mesh, found.shape_bound, found.color_bound, out)
    figures = found.figures()
    out.result(figures, None if out.as_json else _certificate_text(figures))
    if found.within_limits is False:
        raise typer.Exit(STAGE_FAILED)


def render(
    source: MeshFile,
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help="Picture to write (.png).", show_default=False)
    ],
    params: PictureParams,
    out: Output,
    scan: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Scan the mesh was made from: look from its cameras.", show_default=False
        ),
    ] = None,
) -> None:
    """Draw a picture of a mesh, without a window or a GPU.

    Example: scanloom render simplified.ply picture.png --shading edges --view 2
    """
    require_new_file(target, (".png",))
    frames = stages.read_scan(scan).frames if scan is not None else ()
    mesh = read_file(source, out)
    views = stages.viewpoints(mesh, max(params.view, 4), frames=frames, width=params.width)
    if params.view > len(views):
        raise UsageError(f"--view is {params.view}, but there are only {len(views)} views.")
    view = views[params.view - 1]
    target.parent.mkdir(parents=True, exist_ok=True)
    write_png(target, stages.render(mesh, view, shading=params.shading))  # type: ignore[arg-type]
    figures = {"output": str(target), "view": view.name}
    out.result(figures | {"width_px": view.camera.width, "height_px": view.camera.height})


def _patches_text(figures: Mapping[str, Any]) -> str:
    rows = [["largest patches", "area m²", "triangles", "thickness m", "normal"]]
    for number, patch in enumerate(figures["largest_patches"]):
        normal = " ".join(f"{x:.2f}" for x in patch["normal"])
        area, thickness = f"{patch['area_m2']:.4g}", f"{patch['thickness_m']:.3g}"
        rows.append([str(number), area, f"{patch['triangles']:,}", thickness, normal])
    few = figures["patches_of_half_the_area"]
    return (
        f"{figures['patches']:,} patches, {figures['area_m2']:.4g} m²; half of that in the {few:,} largest."
        f"\n\n{table_of(rows)}"
    )


def _write_bounds(
    path: Path,
    mesh: Mesh,
    shape_bound: NDArray[np.float64] | None,
    color_bound: NDArray[np.float64] | None,
    out: Output,
) -> None:
    bounds = {"shape_bound": shape_bound, "color_bound": color_bound}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_ply(path, mesh, {name: values for name, values in bounds.items() if values is not None})
    out.remark(f"{path}: bounds of {len(mesh.triangles):,} triangles")


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


def _certificate_text(figures: Mapping[str, Any]) -> str:
    rows = [["", "found", "proven to be at most"]]
    measures = (("distance m", "shape", "m"), ("colour difference levels", "color", "levels"))
    for name, key, unit in measures:
        found, bound = (figures[f"{key}_{which}_{unit}"] for which in ("attained", "bound"))
        if found is not None:
            rows.append([name, at_least(found), "no bound" if bound is None else at_most(bound)])
    text = table_of(rows)
    if figures["within_limits"] is not None:
        text += f"\n\nLimits {'are kept' if figures['within_limits'] else 'are not proven to be kept'}."
    return f"{text}\n\n{figures['slack_m']:.3g} m of that are for searches in single precision."


def _comparison_text(figures: Mapping[str, Any]) -> str:
    names = {"a_to_b": "A to B", "b_to_a": "B to A", "symmetric": "both ways"}
    measures = ("maximum", "mean", "rms")
    rows = [["", *(f"{m} m" for m in measures), *(f"{m} / diagonal" for m in measures)]]
    for key, name in names.items():
        distance = figures["distance"][key]
        rows.append(
            [
                name,
                *(f"{distance[m + '_m']:.4g}" for m in measures),
                *(f"{distance[m + '_relative']:.3g}" for m in measures),
            ]
        )
    text = table_of(rows)
    if figures["color"] is None:
        text += "\n\nNo colours compared: one of the meshes has none."
    else:
        rows = [["", "RMSE levels", "PSNR dB", "maximum levels"]]
        for key, name in names.items():
            color = figures["color"][key]
            psnr = "equal" if color["psnr_db"] is None else f"{color['psnr_db']:.1f}"
            rows.append([name, f"{color['rmse_levels']:.3g}", psnr, f"{color['maximum_levels']:.3g}"])
        text += "\n\n" + table_of(rows)
    diagonal, samples = figures["diagonal_m"], figures["samples_per_side"]
    return f"{text}\n\nDiagonal of A {diagonal:.4g} m; {samples:,} samples on each mesh."
