"""Command `export`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import MeshFile, locate_diagnostics, read_with_up
from scanloom.cli.options import Changes
from scanloom.cli.output import Output
from scanloom.cli.paths import require_writable
from scanloom.stages import ExportParams
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.exporting.export import EXPORT_SUFFIXES, require_supported_params
from scanloom.stages.exporting.presets import PRESETS, preset
from scanloom.stages.files.codes import FILE_PATH_INVALID


def export(
    source: MeshFile,
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help=f"File to write ({', '.join(EXPORT_SUFFIXES)}).", show_default=False
        ),
    ],
    export: Changes[ExportParams],
    out: Output,
    intent: Annotated[
        str | None,
        typer.Option(
            "--preset",
            metavar="NAME",
            help=f"Purpose: {', '.join(PRESETS)}. Other options override it.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write a mesh for the web, games, Blender or a printer.

    glTF and USD files are upright; meshes in other formats can be rotated, scaled and set on the floor.
    --preset print also reports why a mesh is not watertight, with exit code 1.

    Example: scanloom export out/textured.glb web.glb --preset web
    """
    wanted = replace(ExportParams() if intent is None else preset(intent, target.suffix), **export)
    require_supported_params(target, wanted)
    if target.is_dir():
        raise InputError(FILE_PATH_INVALID, "this is a folder", target, remedy="give the name of a file.")
    require_writable(target.parent)
    mesh = read_with_up(source)
    target.parent.mkdir(parents=True, exist_ok=True)
    with locate_diagnostics(source):
        written = stages.export(mesh, target, wanted)
    out.remark(f"{target}: {written.triangles:,} triangles, {written.bytes:,} bytes")
    out.result({**written.to_dict(), "output": str(target)})
