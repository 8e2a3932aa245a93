"""The command `export`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import MeshFile, about_file, read_standing
from scanloom.cli.options import Changes
from scanloom.cli.output import Output
from scanloom.cli.paths import require_writable
from scanloom.stages import ExportParams
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.exporting.export import SUFFIXES, require_fitting
from scanloom.stages.exporting.presets import PRESETS, preset
from scanloom.stages.files.codes import FILE_PATH_INVALID


def export(
    source: MeshFile,
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help=f"File to write ({', '.join(SUFFIXES)}).", show_default=False),
    ],
    given: Changes[ExportParams],
    out: Output,
    intent: Annotated[
        str | None,
        typer.Option(
            "--preset",
            metavar="NAME",
            help=f"What it is for: {', '.join(PRESETS)}. Options that are given count more.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write a mesh for the program that it is made for: the web, a game engine, Blender, a printer.

    glTF and USD stand upright wherever they are opened; the other formats can be turned, scaled and set on
    the floor. --preset print also says, with exit code 1, why a mesh is not watertight, if it is not.

    Example: scanloom export out/textured.glb web.glb --preset web
    """
    wanted = replace(ExportParams() if intent is None else preset(intent, target.suffix), **given)
    require_fitting(target, wanted)
    if target.is_dir():
        raise InputError(FILE_PATH_INVALID, "this is a folder", target, remedy="give the name of a file.")
    require_writable(target.parent)
    mesh = read_standing(source)
    target.parent.mkdir(parents=True, exist_ok=True)
    with about_file(source):
        written = stages.export(mesh, target, wanted)
    out.remark(f"{target}: {written.triangles:,} triangles, {written.bytes:,} bytes")
    out.result({**written.figures(), "output": str(target)})
