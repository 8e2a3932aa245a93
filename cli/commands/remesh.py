"""Command `remesh`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from scanloom import stages
from scanloom.cli.bake_output import bake_lost_image
from scanloom.cli.mesh_arguments import MeshFile, NewMesh, locate_diagnostics, read_mesh_file
from scanloom.cli.normal_mesh_output import SaveLevels, print_normal_mesh, write_normal_mesh
from scanloom.cli.output import Output, format_size
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file, require_writable
from scanloom.stages import InputError, RemeshParams
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.simplification.codes import SIMPLIFY_TEXTURE_LEFT_OUT
from scanloom.stages.surface.codes import MESH_CONFIDENCE_LEFT_OUT, MESH_NO_SURFACE
from scanloom.stages.surface.formats.ply import read_vertex_values

_SNM = (".snm",)


def remesh(
    source: MeshFile,
    target: NewMesh,
    remesh: RemeshParams,
    out: Output,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File (.snm) for all levels, for scanloom mesh decode; truncated, it is a coarser mesh.",
            show_default=False,
        ),
    ] = None,
    save_levels: SaveLevels = None,
    bake: Annotated[
        bool,
        typer.Option(
            "--bake/--no-bake",
            help="Bake the texture of IN, if OUT is .glb, .obj or .ply. [default: on]",
            show_default=False,
        ),
    ] = True,
) -> None:
    """Remesh a surface into a normal mesh.

    A normal mesh is a base mesh that is refined level by level, with one number per vertex. OUT is the finest
    level, with even triangles on the surface of IN. Colours are kept, and so is a vertex property
    `confidence` of a PLY file. Non-manifold input is split into sheets.

    Example: scanloom mesh remesh clean.ply normal.ply --save normal.snm

    Example: scanloom mesh remesh clean.ply normal.ply --save normal.snm --set remesh.tolerance=1e-4

    Example: scanloom mesh remesh clean.ply normal.ply --levels 5 --set remesh.scheme=butterfly
    """
    require_new_file(target, MESH_SUFFIXES)
    if save is not None:
        require_new_file(save, _SNM)
    if save_levels is not None:
        require_writable(save_levels)
    with collecting(forward=False) as diagnostics:
        mesh = read_mesh_file(source)
    # The confidence is used below.
    emit(*(one for one in diagnostics if one.code != MESH_CONFIDENCE_LEFT_OUT.name))
    with (
        locate_diagnostics(source),
        collecting(forward=False) as diagnostics,
        out.progress("remesh", "levels") as progress,
    ):
        found = stages.remesh(mesh, remesh, confidence=_confidence(source), progress=progress)
    baked = bake_lost_image(target, found.mesh, mesh, out) if bake else None
    with locate_diagnostics(source):
        emit(*(one for one in diagnostics if baked is None or one.code != SIMPLIFY_TEXTURE_LEFT_OUT.name))
    write_normal_mesh(target if baked is None else None, found, save_levels, out)
    if save is not None:
        save.parent.mkdir(parents=True, exist_ok=True)
        found.save(save)
        out.remark(f"{save}: {format_size(len(found.data))}")
    print_normal_mesh(target, found, out, baked)


def _confidence(path: Path) -> NDArray[np.float64] | None:
    values = read_vertex_values(path, "confidence") if path.suffix.lower() == ".ply" else None
    if values is not None and not np.isfinite(values).all():
        raise InputError(
            MESH_NO_SURFACE,
            "the vertex property `confidence` has values that are not finite",
            path,
            remedy="remove the property.",
        )
    return values
