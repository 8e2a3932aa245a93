"""Command `tradeoff`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import MeshFile, locate_diagnostics, read_mesh_file, write_mesh_file
from scanloom.cli.output import Output, format_table
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file
from scanloom.cli.plot_option import plot_option, require_plot
from scanloom.stages import Tradeoff, TradeoffParams, UsageError
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.simplification.codes import SIMPLIFY_TRADEOFF


def tradeoff(
    source: MeshFile,
    tradeoff: TradeoffParams,
    out: Output,
    counts: Annotated[
        str | None,
        typer.Option(
            metavar="N,N,…",
            help="Triangle counts to measure, separated by commas, instead of tradeoff.steps.",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[Path | None, plot_option("the curve")] = None,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Mesh file to write: the suggested mesh.", show_default=False),
    ] = None,
    save_record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File (.npz) for all collapses; scanloom mesh replay makes any of the meshes from it.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Measure the deviation for several triangle counts.

    The mesh is simplified once, to the smallest number; the intermediate meshes are compared with IN in both
    directions, in shape and colour. `scanloom simplify IN OUT --triangles N` then makes the chosen mesh.

    Example: scanloom mesh tradeoff clean.ply --plot curve.png

    Example: scanloom mesh tradeoff model.glb --max-distance 0.001 --save light.glb
    """
    require_plot(plot)
    if save is not None:
        require_new_file(save, MESH_SUFFIXES)
    if save_record is not None:
        require_new_file(save_record, (".npz",))
    wanted = [] if counts is None else [_count(word) for word in counts.split(",")]
    mesh = read_mesh_file(source)
    with locate_diagnostics(source), out.progress("tradeoff", "meshes") as progress:
        found = stages.tradeoff(mesh, tradeoff, counts=wanted, progress=progress)
    if save is not None and found.suggested_triangles is not None:
        write_mesh_file(save, found.mesh, out)
    if save_record is not None:
        save_record.parent.mkdir(parents=True, exist_ok=True)
        found.record.save(save_record)
    if plot is not None:
        from scanloom.stages.rendering.plots import plot_tradeoff

        plot.parent.mkdir(parents=True, exist_ok=True)
        plot_tradeoff(plot, found)
    if found.suggested_triangles is None and tradeoff.max_distance is not None:
        emit(
            SIMPLIFY_TRADEOFF.unmet(
                "no measured triangle count meets {bound}",
                remedy="give more triangles with --counts.",
                bound=found.criterion,
            )
        )
    out.result(found.to_dict(), _text(found))


def _count(word: str) -> int:
    try:
        return int(word.replace("_", ""))
    except ValueError:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "--counts has {word!r}",
            remedy="give whole numbers, such as 50000,20000,5000.",
            word=word,
        ) from None


def _text(found: Tradeoff) -> str:
    if found.suggested_triangles is None:
        return format_table(found.to_rows())
    return (
        f"{format_table(found.to_rows())}\n\nsuggested: {found.suggested_triangles:,} triangles; "
        f"{found.criterion}"
    )
