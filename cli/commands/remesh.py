"""The command `remesh`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from scanloom import stages
from scanloom.cli.baked import baked_by_default
from scanloom.cli.mesh_arguments import MeshFile, NewMesh, about_file, read_file
from scanloom.cli.normal_mesh_output import SaveLevels, tell_normal_mesh, write_normal_mesh
from scanloom.cli.output import Output, size_of
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
    bake: Annotated[
        bool,
        typer.Option(
            "--bake/--no-bake",
            help="Where IN has an image and OUT is .glb, .obj or .ply, make a new image for OUT from it, as "
            "`scanloom bake` does.",
        ),
    ] = True,
) -> None:
    """Make a normal mesh: a base mesh, refined level by level on the surface, one number a vertex.

    OUT is the finest level, which lies on the surface of IN with even triangles. Colours are carried along,
    and so is a property `confidence` of a PLY file's vertices.

    Where IN is no manifold it is split into sheets.

    Example: scanloom remesh clean.ply normal.ply --save normal.snm

    Example: scanloom remesh clean.ply normal.ply --save normal.snm --tolerance 1e-4

    Example: scanloom remesh clean.ply normal.ply --base-triangles 400 --levels 5 --scheme butterfly
    """
    require_new_file(target, MESH_SUFFIXES)
    if save is not None:
        require_new_file(save, _SNM)
    if save_levels is not None:
        require_writable(save_levels)
    with collecting(forward=False) as diagnostics:
        mesh = read_file(source)
    # The confidence is used below.
    emit(*(one for one in diagnostics if one.code != MESH_CONFIDENCE_LEFT_OUT.name))
    with (
        about_file(source),
        collecting(forward=False) as diagnostics,
        out.progress("remesh", "levels") as progress,
    ):
        found = stages.remesh(mesh, params, confidence=_confidence(source), progress=progress)
    baked = baked_by_default(target, found.mesh, mesh, out) if bake else None
    with about_file(source):
        emit(*(one for one in diagnostics if baked is None or one.code != SIMPLIFY_TEXTURE_LEFT_OUT.name))
    write_normal_mesh(target if baked is None else None, found, save_levels, out)
    if save is not None:
        save.parent.mkdir(parents=True, exist_ok=True)
        found.save(save)
        out.remark(f"{save}: {size_of(len(found.data))}")
    tell_normal_mesh(target, found, out, baked)


def _confidence(path: Path) -> NDArray[np.float64] | None:
    values = read_vertex_values(path, "confidence") if path.suffix.lower() == ".ply" else None
    if values is not None and not np.isfinite(values).all():
        raise InputError(
            MESH_NO_SURFACE,
            "has a confidence that is not finite",
            path,
            remedy="remove the property `confidence`.",
        )
    return values
