"""Command `check`."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from scanloom import stages
from scanloom.cli.check_output import SavePlaces, SavePly, list_places, write_colored_classes
from scanloom.cli.mesh_arguments import MeshFile, locate_diagnostics, read_mesh_file
from scanloom.cli.output import Output, format_table
from scanloom.cli.paths import require_new_file
from scanloom.stages import CheckParams, CheckResult
from scanloom.stages.cleaning.check import CLASSES, REQUIREMENTS, validate_requirements
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.atomic_files import write_file_atomically


def check(
    source: MeshFile,
    check: CheckParams,
    out: Output,
    require: Annotated[
        str,
        typer.Option(
            metavar="WORDS",
            help="Requirements, separated by commas; the exit code is 1 if one is not met: "
            + ", ".join(REQUIREMENTS)
            + ".",
            show_default=False,
        ),
    ] = "",
    save_places: SavePlaces = None,
    save_ply: SavePly = None,
) -> None:
    """Find defects of a mesh.

    Counts and locates border edges, non-manifold edges and vertices, needles and caps, folds, spikes,
    self-intersections, thin walls and more. The mesh is not changed.

    Example: scanloom check simplified.ply --require watertight,no-intersecting-triangles
    """
    wanted = [word for part in require.split(",") if (word := part.strip())]
    validate_requirements(wanted, check.min_thickness)
    for path, suffix in ((save_places, ".json"), (save_ply, ".ply")):
        if path is not None:
            require_new_file(path, (suffix,))
    mesh = read_mesh_file(source)
    with locate_diagnostics(source), out.progress("check", "triangles") as progress:
        found = stages.check(mesh, check, progress=progress)
    if save_places is not None:
        save_places.parent.mkdir(parents=True, exist_ok=True)
        with write_file_atomically(save_places) as draft:
            draft.write_text(json.dumps(list_places(found)) + "\n", encoding="utf-8", newline="\n")
    if save_ply is not None:
        write_colored_classes(save_ply, mesh, found, out)
    with locate_diagnostics(source):
        emit(*found.find_unmet(wanted))
    out.result(found.to_dict(), None if out.as_json else _text(found))


def _text(found: CheckResult) -> str:
    topology, metrics = found.topology, found.to_dict()
    words = ("watertight", "is_closed", "is_manifold", "is_oriented")
    holds = (found.is_watertight, topology.is_closed, topology.is_manifold, topology.is_oriented)
    rows = [["", ""]]
    rows += [[w.removeprefix("is_"), "yes" if h else "no"] for w, h in zip(words, holds, strict=True)]
    rows += [[name, f"{getattr(topology, name):,}"] for name in ("vertices", "triangles", "components")]
    rows += [["inside-out components", f"{found.inside_out_count:,}"]]
    if metrics["thickness_min_m"] is not None:
        keys = ("thickness_min_m", "thickness_5_percent_of_triangles_m", "thickness_median_m")
        rows += [["thickness: minimum, 5 %, median", ", ".join(f"{metrics[key]:.4g}" for key in keys) + " m"]]
    text = format_table(rows) + "\n\n"
    irregular: list[list[str]] = [["class", "count", "first location (m)"]]
    for name, (_, _, what) in CLASSES.items():
        points: Any = found.defect_points[name]
        where = ", ".join(f"{x:.4g}" for x in points[0]) if len(points) else ""
        irregular.append([f"{name.replace('_', ' ')}: {what}", f"{len(points):,}", where])
    return text + format_table(irregular)
