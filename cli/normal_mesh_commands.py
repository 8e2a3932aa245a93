"""Commands on normal meshes: remesh, decode."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import stages
from cli.mesh_arguments import MeshFile, NewMesh, about_file, read_file, tell_written
from cli.options import with_options
from cli.output import Output, lines_of, size_of, table_of
from cli.paths import MESH_SUFFIXES, require_file, require_new_file, require_writable
from stages import InputError, NormalMesh, RemeshParams
from stages.surface.formats.ply import read_vertex_values

_SNM = (".snm",)

SaveLevels = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder for a PLY file of each level: level_0.ply, the base mesh, to the finest.",
        show_default=False,
    ),
]


def add_to(app: typer.Typer) -> None:
    """Register the commands."""
    app.command("remesh", rich_help_panel="One stage at a time")(with_options(remesh))
    app.command("decode", rich_help_panel="One stage at a time")(with_options(decode))


def remesh(
    source: MeshFile,
    target: NewMesh,
    params: RemeshParams,
    out: Output,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Keep all levels in this file (.snm), for scanloom decode: small, and its beginning is a "
            "coarser mesh.",
            show_default=False,
        ),
    ] = None,
    save_levels: SaveLevels = None,
) -> None:
    """Make a normal mesh: a base mesh, refined level by level on the surface, one number a vertex.

    OUT is the finest level, which lies on the surface of IN with even triangles. Colours are carried along,
    and so is a property `confidence` of a PLY file's vertices.

    IN must be a manifold mesh; run `scanloom clean` on it first when it is not. Vertices where several fans
    of triangles touch are split.

    Example: scanloom remesh clean.ply normal.ply --save normal.snm --tolerance 1e-4

    Example: scanloom remesh clean.ply normal.ply --base-triangles 400 --levels 5 --scheme butterfly
    """
    require_new_file(target, MESH_SUFFIXES)
    if save is not None:
        require_new_file(save, _SNM)
    if save_levels is not None:
        require_writable(save_levels)
    mesh = read_file(source, out)
    with about_file(source), out.progress("remesh", "levels") as progress:
        found = stages.remesh(mesh, params, confidence=_confidence(source), progress=progress)
    for note in found.mesh.notes[len(mesh.notes) :]:
        out.remark(note)
    _write(target, found, save_levels, out)
    if save is not None:
        save.parent.mkdir(parents=True, exist_ok=True)
        found.save(save)
        out.remark(f"{save}: {size_of(len(found.data))}")
    _tell(target, found, out)


def decode(
    source: Annotated[
        Path, typer.Argument(metavar="FILE", help="File that `remesh --save` wrote.", show_default=False)
    ],
    target: NewMesh,
    out: Output,
    level: Annotated[
        int | None,
        typer.Option(
            metavar="LEVEL",
            help="Which level to write; 0 is the base mesh. The finest that is there if not given.",
            show_default=False,
        ),
    ] = None,
    save_levels: SaveLevels = None,
) -> None:
    """Write the mesh of an .snm file, or one of its coarser levels, equal to the bit to what was remeshed.

    Of a file that is cut short or damaged, the levels before that are decoded, and a warning says what is
    wrong; asking for a level that is not whole is an error.

    Example: scanloom decode normal.snm coarse.ply --level 2
    """
    require_new_file(target, MESH_SUFFIXES)
    if save_levels is not None:
        require_writable(save_levels)
    found = stages.decode(require_file(source), level)
    if found.damage is not None:
        out.remark(f"warning: {source}: only levels 0 to {len(found.offsets)} are whole: {found.damage}")
    _write(target, found, save_levels, out)
    _tell(target, found, out)


def _confidence(path: Path) -> NDArray[np.float64] | None:
    values = read_vertex_values(path, "confidence") if path.suffix.lower() == ".ply" else None
    if values is not None and not np.isfinite(values).all():
        raise InputError("has a confidence that is not finite; remove the property `confidence`.", path)
    return values


def _write(target: Path, found: NormalMesh, folder: Path | None, out: Output) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    found.write(target)
    tell_written(target, found.mesh, out)
    if folder is not None:
        for path, mesh in zip(found.write_levels(folder), found.levels, strict=True):
            tell_written(path, mesh, out)


def _tell(target: Path, found: NormalMesh, out: Output) -> None:
    for warning in found.warnings:
        out.remark(f"warning: {warning}")
    figures = {"output": str(target), **found.figures()}
    out.result(figures, None if out.as_json else _text(figures))


def _text(figures: Mapping[str, Any]) -> str:
    names = ["level", "triangles", "vertices", "exceptions", "boundary vertices", "bytes so far"]
    keys = ["level", "triangles", "vertices", "exceptions", "boundary_vertices", "file_bytes"]
    measured = "max_distance_m" in figures["by_level"][0]
    rows = [[*names, *["largest distance m"] * measured]]
    for one in figures["by_level"]:
        distance = [f"{one['max_distance_m']:.4g}"] if measured else []
        rows.append([*(f"{one[key]:,}" for key in keys), *distance])
    told = ("by_level", "warnings", "damage")
    lines = lines_of({key: value for key, value in figures.items() if key not in told})
    return f"{table_of(rows)}\n\n{lines}"
