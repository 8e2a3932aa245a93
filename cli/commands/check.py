"""The command `check`."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from scanloom import stages
from scanloom.cli.irregular_places import SavePlaces, SavePly, place_lists, write_coloured
from scanloom.cli.mesh_arguments import MeshFile, about_file, read_file
from scanloom.cli.output import Output, table_of
from scanloom.cli.paths import require_new_file
from scanloom.stages import Checked, CheckParams
from scanloom.stages.cleaning.check import CLASSES, REQUIREMENTS, require_answerable
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.replacing import replacing


def check(
    source: MeshFile,
    params: CheckParams,
    out: Output,
    require: Annotated[
        str,
        typer.Option(
            metavar="WORDS",
            help="What must hold, or the exit code is 1; commas between: " + ", ".join(REQUIREMENTS) + ".",
            show_default=False,
        ),
    ] = "",
    save_places: SavePlaces = None,
    save_ply: SavePly = None,
) -> None:
    """Find out whether a mesh is sound: watertight, manifold, free of what the next program stumbles over.

    Every class of irregular place is counted and located: borders, edges of three triangles, pinched
    vertices, needles and caps, folds, spikes, triangles that intersect, thin walls. Nothing is changed.

    Example: scanloom check simplified.ply --require watertight,no-intersecting-triangles
    """
    wanted = [word for part in require.split(",") if (word := part.strip())]
    require_answerable(wanted, params.min_thickness)
    for path, suffix in ((save_places, ".json"), (save_ply, ".ply")):
        if path is not None:
            require_new_file(path, (suffix,))
    mesh = read_file(source)
    with about_file(source), out.progress("check", "triangles") as progress:
        found = stages.check(mesh, params, progress=progress)
    if save_places is not None:
        save_places.parent.mkdir(parents=True, exist_ok=True)
        with replacing(save_places) as draft:
            draft.write_text(json.dumps(place_lists(found)) + "\n", encoding="utf-8", newline="\n")
    if save_ply is not None:
        write_coloured(save_ply, mesh, found, out)
    with about_file(source):
        emit(*found.unmet(wanted))
    out.result(found.figures(), None if out.as_json else _text(found))


def _text(found: Checked) -> str:
    topology, figures = found.topology, found.figures()
    words = ("watertight", "is_closed", "is_manifold", "is_oriented")
    holds = (found.is_watertight, topology.is_closed, topology.is_manifold, topology.is_oriented)
    rows = [["", ""]]
    rows += [[w.removeprefix("is_"), "yes" if h else "no"] for w, h in zip(words, holds, strict=True)]
    rows += [[name, f"{getattr(topology, name):,}"] for name in ("vertices", "triangles", "components")]
    rows += [["pieces that look inwards", f"{found.inside_out:,}"]]
    if figures["thickness_least_m"] is not None:
        keys = ("thickness_least_m", "thickness_5_percent_of_triangles_m", "thickness_median_m")
        rows += [["thickness: least, 5 %, median", ", ".join(f"{figures[key]:.4g}" for key in keys) + " m"]]
    text = table_of(rows) + "\n\n"
    irregular: list[list[str]] = [["class", "places", "first at (m)"]]
    for name, (_, _, what) in CLASSES.items():
        points: Any = found.points[name]
        where = ", ".join(f"{x:.4g}" for x in points[0]) if len(points) else ""
        irregular.append([f"{name.replace('_', ' ')}: {what}", f"{len(points):,}", where])
    return text + table_of(irregular)
