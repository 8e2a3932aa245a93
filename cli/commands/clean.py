"""Command `clean`."""

from __future__ import annotations

from typing import Any

from scanloom import stages
from scanloom.cli.mesh_arguments import MeshFile, NewMesh, locate_diagnostics, read_mesh_file, write_mesh_file
from scanloom.cli.output import Output, format_lines, format_table
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file
from scanloom.stages import CleanParams


def clean(source: MeshFile, target: NewMesh, clean: CleanParams, out: Output) -> None:
    """Remove islands and non-manifold parts of a mesh.

    The result is an oriented manifold; colours are kept. Degenerate and duplicate triangles are removed, too.
    OUT may be IN. --repair also repairs needles, caps, folds and spikes as far as the surface provably stays
    in place; other vertices are not moved.

    Example: scanloom clean fused.ply clean.ply --repair
    """
    require_new_file(target, MESH_SUFFIXES)
    mesh = read_mesh_file(source)
    with locate_diagnostics(source):
        cleaned = stages.clean(mesh, clean)
    write_mesh_file(target, cleaned.mesh, out)
    metrics = {"output": str(target), **cleaned.to_dict()}
    with_table = cleaned.repair_result is not None and not out.as_json
    out.result(metrics, _text(metrics) if with_table else None)


def _text(metrics: dict[str, Any]) -> str:
    """Return the metrics of a repaired mesh, with a table of the classes that have defects."""
    repaired = metrics["repair"]
    alone = {name: value for name, value in metrics.items() if name != "repair"}
    alone |= {"repair_bound_m": repaired["bound_m"], "repair_max_shape_m": repaired["max_shape_m"]}
    columns = ("found", "repaired", "left", "rolled_back")
    rows = [["class", *(name.replace("_", " ") for name in columns)]]
    rows += [
        [name.replace("_", " "), *(f"{counts[column]:,}" for column in columns)]
        for name, counts in repaired["classes"].items()
        if counts["found"]
    ]
    return format_lines(alone) + (f"\n\n{format_table(rows)}" if len(rows) > 1 else "")
