"""The command `compare`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

import stages
from cli.mesh_arguments import read_file
from cli.output import Output, table_of
from cli.overlap import require_overlap
from stages import CompareParams


def compare(
    reference: Annotated[
        Path, typer.Argument(metavar="A", help="Mesh file to measure against.", show_default=False)
    ],
    other: Annotated[Path, typer.Argument(metavar="B", help="Mesh file to measure.", show_default=False)],
    params: CompareParams,
    out: Output,
) -> None:
    """Measure how far two meshes are apart, in shape (both ways) and in colour.

    Meshes that lie apart by more than the smaller one's size are not of one thing: the exit code is then 1.
    Relative distances refer to the diagonal of the bounding box of A.

    Example: scanloom compare fused.ply simplified.ply --json
    """
    mesh_a, mesh_b = read_file(reference, out), read_file(other, out)
    figures = stages.compare(mesh_a, mesh_b, params).figures()
    require_overlap(other, mesh_b, reference, mesh_a, out)
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
    diagonal, samples = figures["diagonal_m"], figures["samples_per_side"]
    return f"{text}\n\nDiagonal of A {diagonal:.4g} m; {samples:,} samples on each mesh."
