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
    in place; other vertices are not moved. --solid closes the surface for 3-D printing.

    Example: scanloom clean fused.ply clean.ply --repair
    """
    require_new_file(target, MESH_SUFFIXES)
    mesh = read_mesh_file(source)
    with locate_diagnostics(source):
        cleaned = stages.clean(mesh, clean)
    write_mesh_file(target, cleaned.mesh, out)
    metrics = {"output": str(target), **cleaned.to_dict()}
    is_nested = cleaned.repair_result is not None or cleaned.solid_result is not None
    out.result(metrics, _text(metrics) if is_nested and not out.as_json else None)


def _text(metrics: dict[str, Any]) -> str:
    """Return the metrics of a repaired or solid mesh, with a table of the classes that have defects."""
    alone = {name: value for name, value in metrics.items() if name not in ("repair", "solid")}
    alone |= {f"solid_{name}": value for name, value in metrics.get("solid", {}).items()}
    if "repair" not in metrics:
        return format_lines(alone)
    repaired = metrics["repair"]
    alone |= {"repair_bound_m": repaired["bound_m"], "repair_max_shape_m": repaired["max_shape_m"]}
    columns = ("found", "repaired", "left", "rolled_back")
    rows = [["class", *(name.replace("_", " ") for name in columns)]]
    rows += [
        [name.replace("_", " "), *(f"{counts[column]:,}" for column in columns)]
        for name, counts in repaired["classes"].items()
        if counts["found"]
    ]
    return format_lines(alone) + (f"\n\n{format_table(rows)}" if len(rows) > 1 else "")
