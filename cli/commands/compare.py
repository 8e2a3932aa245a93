"""The command `compare`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

import stages
from cli.deviation_picture import write_deviation_picture
from cli.mesh_arguments import SHAPE_ALONE, about_file, read_file, write_file
from cli.output import Output, table_of
from cli.overlap import require_overlap
from cli.paths import MESH_SUFFIXES, require_new_file
from stages import ChangeParams, CompareParams, DeviationParams, UsageError

# Formats that keep the colours of a change.
COLORED_SUFFIXES = tuple(suffix for suffix in MESH_SUFFIXES if suffix not in SHAPE_ALONE)


def compare(
    reference: Annotated[
        Path, typer.Argument(metavar="A", help="Mesh file to measure against.", show_default=False)
    ],
    other: Annotated[Path, typer.Argument(metavar="B", help="Mesh file to measure.", show_default=False)],
    params: CompareParams,
    told: DeviationParams,
    changed: ChangeParams,
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
) -> None:
    """Measure how far two meshes are apart, in shape (both ways) and in colour.

    Where A is oriented, the deviations of B from it have signs: positive on the side that A looks to. Of them
    percentiles are told, the worst places, and what share is within --tolerance; colours also as ΔE2000.

    --change is for two scans of one place: what is farther from the other mesh than --change-distance is new,
    or gone. What the later scan did not see counts as gone.

    Meshes that lie apart by more than the smaller one's size are not of one thing: the exit code is then 1.
    Relative distances refer to the diagonal of the bounding box of A.

    Example: scanloom compare fused.ply simplified.ply --json
    """
    if how not in ("none", "icp"):
        raise UsageError(f"--align is {how!r}; it must be none or icp.")
    if save_aligned is not None:
        if how == "none":
            raise UsageError("--save-aligned needs --align icp: nothing is moved without it.")
        require_new_file(save_aligned, MESH_SUFFIXES)
    if save_change is not None:
        if not change:
            raise UsageError("--save-change needs --change.")
        require_new_file(save_change, COLORED_SUFFIXES)
    for path, suffix in ((save_ply, ".ply"), (picture, ".png")):
        if path is not None:
            require_new_file(path, (suffix,))
    mesh_a, mesh_b = read_file(reference, out), read_file(other, out)
    alignment = None
    if how == "icp":
        with about_file(other), about_file(reference, "reference"):
            mesh_b, alignment = stages.align(mesh_b, mesh_a)
    figures = stages.compare(mesh_a, mesh_b, params).figures()
    require_overlap(other, mesh_b, reference, mesh_a, out)
    found = stages.deviations(mesh_a, mesh_b, told)
    if save_aligned is not None:
        write_file(save_aligned, mesh_b, out)
    if save_ply is not None:
        write_file(save_ply, found.painted, out)
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        write_deviation_picture(picture, found, told.palette)
    moved = stages.changes(mesh_a, mesh_b, changed) if change else None
    if moved is not None and save_change is not None:
        write_file(save_change, moved.painted, out)
    figures |= {
        "change": None if moved is None else moved.figures(),
        "deviation": found.figures(),
        "alignment": None if alignment is None else alignment.figures(),
    }
    out.result(figures, None if out.as_json else _comparison_text(figures))


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
    text += "\n\n" + _deviation_text(figures["deviation"])
    if figures["alignment"] is not None:
        moved = figures["alignment"]
        text += (
            f"\n\nB was moved onto A by {moved['moved_rms_m']:.4g} m RMS, and turned by "
            f"{moved['angle_degrees']:.4g} degrees; {moved['overlap']:.0%} of it has a partner."
        )
    if figures["change"] is not None:
        text += "\n\n" + _change_text(figures["change"])
    diagonal, samples = figures["diagonal_m"], figures["samples_per_side"]
    return f"{text}\n\nDiagonal of A {diagonal:.4g} m; {samples:,} samples on each mesh."


def _change_text(told: Mapping[str, Any]) -> str:
    text = (
        f"New in B: {told['new_area_m2']:.4g} m² in {told['new_places']:,} places; gone of A: "
        f"{told['gone_area_m2']:.4g} m² in {told['gone_places']:,}; farther than {told['distance_m']:.4g} m."
    )
    if not told["largest"]:
        return text
    rows = [["largest changes", "m²", "in the middle, m"]]
    rows += [
        [one["kind"], f"{one['area_m2']:.4g}", ", ".join(f"{x:.4g}" for x in one["point_m"])]
        for one in told["largest"]
    ]
    return f"{text}\n\n{table_of(rows)}"


def _deviation_text(told: Mapping[str, Any]) -> str:
    distances = told["absolute_percentiles_m"]
    rows = [["deviation of B from A", "m"]]
    rows += [[f"{p} % are within", f"{d:.4g}"] for p, d in distances.items()]
    rows.append(["RMS", f"{told['rms_m']:.4g}"])
    if told["is_signed"]:
        rows.append(["mean, with signs", f"{told['mean_m']:+.4g}"])
        rows.append(["standard deviation", f"{told['standard_deviation_m']:.4g}"])
        rows.append(["lowest, highest", f"{told['lowest_m']:+.4g}, {told['highest_m']:+.4g}"])
    worst = told["worst"][0]
    place = ", ".join(f"{x:.4g}" for x in worst["point_m"])
    sign = "+" if told["is_signed"] else ""
    rows.append([f"worst, at ({place})", f"{worst['distance_m']:{sign}.4g}"])
    text = table_of(rows)
    if told["share_within"] is not None:
        text += f"\n\n{told['share_within']:.2%} within {told['tolerance_m']:g} m"
        if told["is_signed"]:
            text += f", {told['share_over']:.2%} over, {told['share_under']:.2%} under"
        text += "."
    if told["delta_e_2000"] is not None:
        of_color = told["delta_e_2000"]
        most = of_color["percentiles"]["95"]
        text += f"\n\nΔE2000 of colours: {of_color['mean']:.3g} on average, 95 % within {most:.3g}."
    return text
