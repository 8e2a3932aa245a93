"""Output of `mesh remesh` and `mesh decode`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom.cli.bake_output import format_bake
from scanloom.cli.mesh_arguments import remark_written
from scanloom.cli.output import Output, format_lines, format_table
from scanloom.stages import NormalMesh

SaveLevels = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder for a PLY file of each level: level_0.ply, the base mesh, to the finest.",
        show_default=False,
    ),
]


def write_normal_mesh(target: Path | None, found: NormalMesh, folder: Path | None, out: Output) -> None:
    """Write the finest level to `target`, and all levels into `folder`, if given."""
    if target is not None:
        target.parent.mkdir(parents=True, exist_ok=True)
        found.write(target)
        remark_written(target, found.mesh, out)
    if folder is not None:
        for path, mesh in zip(found.write_levels(folder), found.levels, strict=True):
            remark_written(path, mesh, out)


def print_normal_mesh(
    target: Path, found: NormalMesh, out: Output, baked: dict[str, Any] | None = None
) -> None:
    """Print the metrics of each level and of the baked texture."""
    metrics = {"output": str(target), **found.to_dict()}
    text = None if out.as_json else _text(metrics)
    if baked is not None:
        metrics["baked"] = baked
        text = None if text is None else f"{text}\n\n{format_bake(baked)}"
    out.result(metrics, text)


def _text(metrics: Mapping[str, Any]) -> str:
    names = ["level", "triangles", "vertices", "exceptions", "boundary vertices", "bytes so far"]
    keys = ["level", "triangles", "vertices", "exceptions", "boundary_vertices", "file_bytes"]
    measured = "max_distance_m" in metrics["by_level"][0]
    rows = [[*names, *["largest distance m"] * measured]]
    for one in metrics["by_level"]:
        distance = [f"{one['max_distance_m']:.4g}"] if measured else []
        rows.append([*(f"{one[key]:,}" for key in keys), *distance])
    tables = ("by_level", "damage")
    lines = format_lines({key: value for key, value in metrics.items() if key not in tables})
    return f"{format_table(rows)}\n\n{lines}"
