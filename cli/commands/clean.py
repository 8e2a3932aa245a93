"""The command `clean`."""

from __future__ import annotations

from typing import Any

from scanloom import stages
from scanloom.cli.mesh_arguments import MeshFile, NewMesh, about_file, read_file, write_file
from scanloom.cli.output import Output, lines_of, table_of
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file
from scanloom.stages import CleanParams


def clean(source: MeshFile, target: NewMesh, params: CleanParams, out: Output) -> None:
    """Remove what a mesh should not have: islands, degenerate, duplicate and non-manifold parts.

    What comes out is an oriented manifold; colours survive. OUT may be IN: it is replaced in one step. With
    --repair, needles, caps, folds and spikes go as far as the surface provably stays where it is; all else
    keeps its bits, and what is left is told.

    Example: scanloom clean fused.ply clean.ply --repair
    """
    require_new_file(target, MESH_SUFFIXES)
    mesh = read_file(source)
    with about_file(source):
        cleaned = stages.clean(mesh, params)
    write_file(target, cleaned.mesh, out)
    figures = {"output": str(target), **cleaned.figures()}
    with_table = cleaned.repaired is not None and not out.as_json
    out.result(figures, _text(figures) if with_table else None)


def _text(figures: dict[str, Any]) -> str:
    """Return the figures of a mesh that was repaired, with a table of the classes that have any places."""
    repaired = figures["repair"]
    alone = {name: value for name, value in figures.items() if name != "repair"}
    alone |= {"repair_bound_m": repaired["bound_m"], "repair_max_shape_m": repaired["max_shape_m"]}
    columns = ("found", "repaired", "left", "rolled_back")
    rows = [["class", *(name.replace("_", " ") for name in columns)]]
    rows += [
        [name.replace("_", " "), *(f"{counts[column]:,}" for column in columns)]
        for name, counts in repaired["classes"].items()
        if counts["found"]
    ]
    return lines_of(alone) + (f"\n\n{table_of(rows)}" if len(rows) > 1 else "")
