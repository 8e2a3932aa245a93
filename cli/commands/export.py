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
from scanloom.stages import ExportParams, SimulationParams
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.exporting.export import (
    EXPORT_SUFFIXES,
    require_supported_params,
    set_up_direction,
)
from scanloom.stages.exporting.presets import PRESETS, SIMULATION_PRESET, preset
from scanloom.stages.exporting.simulation.export_simulation import require_simulation_target
from scanloom.stages.files.codes import FILE_PATH_INVALID


def export(
    source: MeshFile,
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help=f"File ({', '.join(EXPORT_SUFFIXES)}), or folder with --preset {SIMULATION_PRESET}.",
            show_default=False,
        ),
    ],
    export: Changes[ExportParams],
    simulation: Changes[SimulationParams],
    out: Output,
    intent: Annotated[
        str | None,
        typer.Option(
            "--preset",
            metavar="NAME",
            help=f"Purpose: {', '.join((*PRESETS, SIMULATION_PRESET))}. Other options override it.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write a mesh for web, games, printers or simulators.

    glTF and USD files are upright; meshes in other formats can be rotated, scaled and set on the floor.
    --preset print also reports why a mesh is not watertight, with exit code 1. --preset sim writes a folder
    with USD, MJCF, URDF and SDF models and convex collision parts whose error is proven; --split objects
    makes one body for each object on a floor or table.

    Example: scanloom export out/textured.glb web.glb --preset web
    """
    if intent == SIMULATION_PRESET:
        _export_simulation(source, target, export, simulation, out)
        return
    if simulation:
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "parameters of simulation require --preset {preset}.",
            preset=SIMULATION_PRESET,
        )
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


def _export_simulation(
    source: Path,
    target: Path,
    export: Changes[ExportParams],
    simulation: Changes[SimulationParams],
    out: Output,
) -> None:
    """Write the folder of a simulation model."""
    if ignored := sorted(set(export) - {"up"}):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "{names} does not apply to --preset {preset}, which writes z-up models in metres.",
            names=" and ".join(ignored),
            preset=SIMULATION_PRESET,
        )
    require_simulation_target(target)
    require_writable(target.parent)
    mesh = set_up_direction(read_with_up(source), ExportParams(**export).up)
    with locate_diagnostics(source), out.progress("simulation", "steps") as progress:
        written = stages.export_simulation(mesh, target, SimulationParams(**simulation), progress=progress)
    parts = sum(len(body.parts) for body in written.bodies)
    excess = 1000 * max(body.proof.excess_m for body in written.bodies)
    gap = 1000 * max(body.proof.gap_m for body in written.bodies)
    bodies = f"{len(written.bodies):,} bodies, " if len(written.bodies) > 1 else ""
    inside = f", and at most {gap:.3g} mm inside" if gap > 0 else ""
    out.remark(
        f"{target}: {bodies}{parts:,} collision parts, at most {excess:.3g} mm outside the surface{inside}"
    )
    out.result({**written.to_dict(), "output": str(target)})
