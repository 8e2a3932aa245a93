"""The command `run`: the whole way."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scanloom.cli.options import Changes
from scanloom.cli.output import Output, size_of, table_of
from scanloom.cli.paths import require_scan, require_writable
from scanloom.cli.plot_option import plot_option, require_plot
from scanloom.cli.quality import QualityOption
from scanloom.cli.run_options import (
    CacheOption,
    ConfigOption,
    DiskOption,
    ForceOption,
    MemoryOption,
    OverwriteOption,
    PageOption,
    ReportOption,
    SetOption,
    UntilOption,
    bytes_or_none,
    run_config,
)
from scanloom.cli.watch import watching
from scanloom.stages import ScanParams, UsageError
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT

if TYPE_CHECKING:
    from scanloom.pipeline.run.dry_run import DryRun
    from scanloom.pipeline.run.run import RunResult


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
    config_file: ConfigOption = None,
    quality: QualityOption = None,
    settings: SetOption = None,
    until: UntilOption = None,
    force: ForceOption = None,
    overwrite: OverwriteOption = False,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Only say what would be done, and write nothing: the stages, which of them are cached and "
            "why the others are not, and the seconds and memory to expect.",
        ),
    ] = False,
    cache: CacheOption = None,
    page: PageOption = None,
    report: ReportOption = None,
    memory: MemoryOption = None,
    disk: DiskOption = None,
    plot: Annotated[Path | None, plot_option("how long each stage took")] = None,
) -> None:
    """Make a light, coloured mesh from a scan folder; every stage's result is kept and reused.

    report.html shows the result in a browser, without a network: --no-page leaves it out.

    OUT then holds fused.ply, clean.ply, simplified.ply, textured.glb (the simplified mesh with what the
    photos show), report.json and pictures. A second run does only what has changed since. --hold-out 10
    keeps every tenth frame from all stages and tells how near the result comes to it. With --set
    bake.enabled=true OUT also holds baked.glb: the simplified mesh with a texture that shows all colour of
    the clean one. With --set remesh.enabled=true it holds a normal mesh: remeshed.ply, all its levels, and
    remeshed.snm. With --set lod.enabled=true it holds levels of detail of the clean mesh, lod.slod, and the
    same as 3D Tiles in tiles/. Where frames have no colour, simplified.glb stands for textured.glb; both are
    turned upright. With --set export.web=true it holds web.glb, of a few bytes for viewers of the web.

    --memory and --disk end a run that would take more, and say with which voxel size it would not.

    --quality draft is for a first look, best for what is kept; --config and --set win over it.

    Example: scanloom run my_scan -o my_mesh --set fuse.voxel_size=0.01 --set simplify.max_shape=0.005
    """
    from scanloom.pipeline.run.dry_run import foresee
    from scanloom.pipeline.run.limits import Limits
    from scanloom.pipeline.run.run import run as run_pipeline

    require_scan(scan)
    if dry_run and plot is not None:
        raise UsageError(
            USAGE_OPTIONS_CONFLICT, "--plot draws how long stages took; --dry-run writes nothing."
        )
    require_plot(plot)
    config = run_config(config_file, quality, settings, scan_options, page, report)
    limits = Limits(bytes_or_none(memory, "--memory"), bytes_or_none(disk, "--disk"))
    require_writable(target)
    how: dict[str, Any] = {
        "until": until,
        "force": tuple(force or ()),
        "cache_dir": cache,
        "overwrite": overwrite,
    }
    if dry_run:
        _tell_dry_run(foresee(scan, target, config, **how), out)
        return
    with watching(out) as events:
        result = run_pipeline(scan, target, config, **how, limits=limits, events=events)
    if plot is not None:
        _plot(plot, result)
    out.result(result.figures(), _summary(result))


def _plot(path: Path, result: RunResult) -> None:
    """Draw the seconds of each stage."""
    from scanloom.stages.picturing.plots import plot_seconds

    seconds = {one.stage: float(one.made["seconds"]) for one in result.stages}
    path.parent.mkdir(parents=True, exist_ok=True)
    plot_seconds(path, seconds, {one.stage for one in result.stages if one.cached})


def _tell_dry_run(found: DryRun, out: Output) -> None:
    """Print what a run would do; that it would be refused is a warning."""
    figures = found.figures()
    rows = [["stage", "", "seconds", "memory", "expected from"]]
    for one in found.stages:
        take = one.expected
        rows.append(
            [one.stage, "cached", "", "", ""]
            if take is None
            else [one.stage, "runs", f"{take.seconds:.1f}", size_of(take.memory_bytes), _BASES[take.basis]]
        )
    reasons = [f"{one.stage}: {one.reason}" for one in found.stages if not one.cached]
    lines = [f"{found.layout}, {found.frames:,} frames; nothing is written.", "", table_of(rows)]
    if reasons:
        lines += [
            "",
            *reasons,
            "",
            f"about {found.seconds:.0f} s, and {size_of(found.memory_bytes)} at the most",
        ]
    out.result(figures, "\n".join(lines))


# What an expectation rests on, in words.
_BASES = {
    "measured": "the same work before",
    "scaled": "other work before",
    "estimated": "the size of the scan (an estimate)",
}


def _summary(result: RunResult) -> str:
    """Say how good the final mesh is, and where the results are."""
    mesh = result.report["mesh"]
    lines = []
    if mesh is not None:
        # One way only: the other way would mostly tell how far away the islands were that cleaning removed.
        distance = mesh["to_fused"]["distance"]["b_to_a"]
        m = "m" if result.report["scan"]["metric"] else "units"
        color = (mesh["to_fused"]["color"] or {}).get("b_to_a")
        lines += [
            f"{mesh['triangles']:,} triangles, {'' if mesh['manifold'] else 'not '}manifold",
            f"off the fused mesh by {distance['rms_m']:.3g} {m} RMS, {distance['maximum_m']:.3g} {m} at most"
            + (f"; colour by {color['rmse_levels']:.3g} of 255 levels RMS" if color else ""),
        ]
    held_out = result.report.get("held_out")
    if held_out and held_out["photos"]:
        lines.append(
            f"{held_out['photos']} photos held out: PSNR {held_out['psnr_affine_db']:.1f} dB "
            f"({held_out['psnr_raw_db']:.1f} raw), SSIM {held_out['ssim']:.3f}, sharpness "
            f"{held_out['sharpness']:.2f}, {held_out['coverage_share']:.0%} of their pixels"
        )
    placed = [path.relative_to(result.out).parts for stage in result.stages for path in stage.results]
    names = dict.fromkeys(parts[0] + ("/" if parts[1:] else "") for parts in placed)
    pages = [] if result.page is None else [result.page.name]
    lines.append(f"results in {result.out}: {', '.join([*names, 'report.json', *pages])}")
    return "\n".join(lines)
