"""The command `tradeoff`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import MeshFile, about_file, read_file, write_file
from scanloom.cli.output import Output, table_of
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file
from scanloom.cli.plot_option import plot_option, require_plot
from scanloom.stages import Tradeoff, TradeoffParams, UsageError
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.simplification.codes import SIMPLIFY_TRADEOFF


def tradeoff(
    source: MeshFile,
    params: TradeoffParams,
    out: Output,
    counts: Annotated[
        str | None,
        typer.Option(
            metavar="N,N,…",
            help="Numbers of triangles, with commas between them, in place of --steps and --least.",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[Path | None, plot_option("the curve")] = None,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Mesh file for the one that is suggested.", show_default=False),
    ] = None,
    save_record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Keep the collapses in this file (.npz): scanloom replay makes any of the meshes of it.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Tell how far a mesh would be off at any number of triangles, so that a person can pick one.

    It is simplified once, to the fewest; every number on the way is measured against IN, both ways, in shape
    and in colour. `scanloom simplify IN OUT --triangles N` then makes the mesh of the number that is picked.

    Example: scanloom tradeoff clean.ply --plot curve.png

    Example: scanloom tradeoff model.glb --within 0.001 --save light.glb
    """
    require_plot(plot)
    if save is not None:
        require_new_file(save, MESH_SUFFIXES)
    if save_record is not None:
        require_new_file(save_record, (".npz",))
    wanted = [] if counts is None else [_count(word) for word in counts.split(",")]
    mesh = read_file(source)
    with about_file(source), out.progress("tradeoff", "meshes") as progress:
        found = stages.tradeoff(mesh, params, counts=wanted, progress=progress)
    if save is not None and found.suggested is not None:
        write_file(save, found.mesh, out)
    if save_record is not None:
        save_record.parent.mkdir(parents=True, exist_ok=True)
        found.record.save(save_record)
    if plot is not None:
        from scanloom.stages.picturing.plots import plot_tradeoff

        plot.parent.mkdir(parents=True, exist_ok=True)
        plot_tradeoff(plot, found)
    if found.suggested is None and params.within is not None:
        emit(
            SIMPLIFY_TRADEOFF.unmet(
                "none of these numbers keeps {bound}",
                remedy="give more triangles with --counts.",
                bound=found.why,
            )
        )
    out.result(found.figures(), _text(found))


def _count(word: str) -> int:
    try:
        return int(word.replace("_", ""))
    except ValueError:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "--counts has {word!r}",
            remedy="give whole numbers, say 50000,20000,5000.",
            word=word,
        ) from None


def _text(found: Tradeoff) -> str:
    if found.suggested is None:
        return table_of(found.rows())
    return f"{table_of(found.rows())}\n\nsuggested: {found.suggested:,} triangles; {found.why}"
