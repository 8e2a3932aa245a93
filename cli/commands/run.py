"""The command `run`: the whole way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import Changes
from cli.output import Output
from cli.paths import require_scan, require_writable
from cli.watch import tell_skipped, watching
from stages import ScanParams

if TYPE_CHECKING:
    from pipeline.run import RunResult


def run(
    scan: Annotated[
        Path,
        typer.Argument(
            metavar="SCAN",
            help="Folder of the scan, or a recording (.bag, .db3, .sens, .r3d).",
            show_default=False,
        ),
    ],
    target: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="OUT", help="Folder for the results.", show_default=False),
    ],
    scan_options: Changes[ScanParams],
    out: Output,
    config_file: Annotated[
        Path | None,
        typer.Option(
            "--config", metavar="FILE", help="Parameters as TOML; see scanloom config.", show_default=False
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="STAGE.PARAM=VALUE",
            help="Change one parameter, after --config; may be given many times.",
            show_default=False,
        ),
    ] = None,
    until: Annotated[
        str | None, typer.Option(metavar="STAGE", help="Stop after this stage.", show_default=False)
    ] = None,
    force: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STAGE",
            help="Run this stage even though its result is cached; may be given many times.",
            show_default=False,
        ),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Where the results of stages are kept; $SCANLOOM_CACHE, or OUT/cache, if not given.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Make a light, coloured mesh from a scan folder; every stage's result is kept and reused.

    OUT then holds fused.ply, clean.ply, simplified.ply, report.json and pictures. A second run does only
    what has changed since. With --set bake.enabled=true it also holds baked.glb: the simplified mesh with a
    texture that shows all colour. With --set remesh.enabled=true it holds a normal mesh: remeshed.ply, all
    its levels, and remeshed.snm.

    Example: scanloom run my_scan -o my_mesh --set fuse.voxel_size=0.01 --set simplify.max_shape=0.005
    """
    from pipeline.config import Config
    from pipeline.run import run as run_pipeline
    from stages.simplification.auto import chosen

    require_scan(scan)
    config = Config.load(config_file) if config_file is not None else Config()
    config = config.set(settings or ())
    config = replace(config, scan=replace(config.scan, **scan_options))
    chosen(config.simplify)  # what does not go together is said now, not after hours of fusion
    require_writable(target)
    with watching(out) as events:
        result = run_pipeline(
            scan, target, config, until=until, force=tuple(force or ()), cache_dir=cache, events=events
        )
    tell_skipped(out, "the reader", result.report["scan"])
    out.result(result.figures(), _summary(result))


def _summary(result: RunResult) -> str:
    """Say how good the final mesh is, and where the results are."""
    mesh = result.report["mesh"]
    lines = []
    if mesh is not None:
        # One way only: the other way would mostly tell how far away the islands were that cleaning removed.
        distance = mesh["to_fused"]["distance"]["b_to_a"]
        color = (mesh["to_fused"]["color"] or {}).get("b_to_a")
        lines += [
            f"{mesh['triangles']:,} triangles, {'' if mesh['manifold'] else 'not '}manifold",
            f"off the fused mesh by {distance['rms_m']:.3g} m RMS, {distance['maximum_m']:.3g} m at most"
            + (f"; colour by {color['rmse_levels']:.3g} of 255 levels RMS" if color else ""),
        ]
    placed = [path.relative_to(result.out).parts for stage in result.stages for path in stage.results]
    names = dict.fromkeys(parts[0] + ("/" if parts[1:] else "") for parts in placed)
    lines.append(f"results in {result.out}: {', '.join([*names, 'report.json'])}")
    return "\n".join(lines)
