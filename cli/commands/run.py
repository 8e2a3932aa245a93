"""Command `run`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from scanloom.cli.bake_output import format_shading_errors
from scanloom.cli.options import Changes, OptionsFor
from scanloom.cli.output import Output, format_size, format_table
from scanloom.cli.paths import require_scan, require_writable
from scanloom.cli.plot_option import require_plot
from scanloom.cli.quality_option import QualityOption
from scanloom.cli.rendering import as_typed
from scanloom.cli.run_options import (
    ConfigOption,
    ConfigWords,
    DryRunOption,
    LimitsParams,
    OutOption,
    RunParams,
    UntilOption,
    load_run_config,
)
from scanloom.cli.run_progress import show_run_progress
from scanloom.cli.scan_argument import ScanFolder
from scanloom.stages import ScanParams, SimplifyParams, UsageError
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.params import param
from scanloom.stages.printing import format_upper_bound
from scanloom.stages.registration.codes import CAMERA_FOCAL_ESTIMATED
from scanloom.stages.scans.codes import CAMERA_INTRINSICS_GUESSED

if TYPE_CHECKING:
    from scanloom.pipeline.run.dry_run import DryRun
    from scanloom.pipeline.run.run import RunResult


@dataclass(frozen=True, kw_only=True)
class SingleRunParams(RunParams):
    """Cache of a run, files and results that it replaces, and the plot of its times."""

    plot: str | None = param(
        None,
        "Picture (.png or .svg) of the time of each stage; needs the extra `plot`.",
        is_path=True,
    )


def run(
    folder: ScanFolder,
    target: OutOption,
    scan: Changes[ScanParams],
    simplify: Annotated[Changes[SimplifyParams], OptionsFor(("triangles", "ratio", "max_shape"))],
    limits: LimitsParams,
    run: SingleRunParams,
    words: ConfigWords,
    out: Output,
    config_file: ConfigOption = None,
    quality: QualityOption = None,
    until: UntilOption = None,
    dry_run: DryRunOption = False,
) -> None:
    """Turn a scan into a textured mesh.

    OUT gets fused.ply, clean.ply, refined.ply, simplified.ply, textured.glb (simplified.glb if frames have no
    colour), report.json, and report.html, a page that shows the result. A second run repeats only the
    stages whose input or parameters have changed.

    --quality draft is for a first look, best for final results; --config and --set override it.

    Further results: --set bake.enabled=true (baked.glb, the colours of the refined mesh in a texture),
    remesh.enabled=true (remeshed.ply and remeshed.snm), lod.enabled=true (lod.slod and tiles/),
    export.web=true (web.glb), coverage.enabled=true. --set scan.hold_out=10 withholds every tenth frame
    from all stages and compares its photo with the result. --set report.page=false omits the page.

    Example: scanloom run my_scan -o my_mesh

    Example: scanloom run my_scan -o my_mesh --set fuse.voxel_size=1cm --max-shape 5mm
    """
    from scanloom.pipeline.run.dry_run import predict_run
    from scanloom.pipeline.run.limits import Limits
    from scanloom.pipeline.run.run import run as run_pipeline

    require_scan(folder)
    plot = None if run.plot is None else Path(run.plot)
    if dry_run and plot is not None:
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "run.plot plots the times of stages, but --dry-run runs none; omit one of them.",
        )
    require_plot(plot)
    config = load_run_config(config_file, quality, words, scan, simplify)
    require_writable(target)
    how: dict[str, Any] = {
        "until": until,
        "force": run.forced,
        "cache_dir": run.cache_folder,
        "overwrite": run.overwrite,
    }
    if dry_run:
        _print_plan(predict_run(folder, target, config, **how), out)
        return
    with show_run_progress(out) as events:
        result = run_pipeline(
            folder,
            target,
            config,
            **how,
            limits=Limits(limits.memory_bytes, limits.disk_bytes),
            events=events,
        )
    if plot is not None:
        _plot(plot, result)
    out.result(result.to_dict(), _summary(result))


def _plot(path: Path, result: RunResult) -> None:
    """Draw the seconds of each stage."""
    from scanloom.stages.rendering.plots import plot_seconds

    seconds = {one.stage: float(one.compute_cost["seconds"]) for one in result.stages}
    path.parent.mkdir(parents=True, exist_ok=True)
    plot_seconds(path, seconds, {one.stage for one in result.stages if one.cached})


def _print_plan(found: DryRun, out: Output) -> None:
    """Print the stages that a run would execute, with time and memory."""
    metrics = found.to_dict()
    rows = [["stage", "", "seconds", "memory", "estimated from"]]
    for one in found.stages:
        take = one.estimate
        rows.append(
            [one.stage, "cached", "", "", ""]
            if take is None
            else [
                one.stage,
                "runs",
                f"{take.seconds:.1f}",
                format_size(take.memory_bytes),
                _BASES[take.basis],
            ]
        )
    reasons = [f"{one.stage}: {one.reason}" for one in found.stages if not one.cached]
    lines = [f"{found.layout}, {found.frames:,} frames; nothing is written.", "", format_table(rows)]
    if reasons:
        lines += [
            "",
            *reasons,
            "",
            f"about {found.seconds:.0f} s, at most {format_size(found.memory_bytes)} of memory",
        ]
    out.result(metrics, "\n".join(lines))


# Descriptions of the sources of an estimated time.
_BASES = {
    "measured": "an earlier identical computation",
    "scaled": "earlier computations, scaled",
    "estimated": "the size of the scan (rough)",
}


def _summary(result: RunResult) -> str:
    """Return the quality and size of the final mesh, and the location of the results."""
    mesh = result.report["mesh"]
    models = [path for stage in result.stages if stage.stage == "texture" for path in stage.results]
    textured = next((path for path in models if path.suffix == ".glb"), None)
    lines = []
    if mesh is not None:
        # From the result to the fused mesh only: the other direction is dominated by removed islands.
        distance = mesh["to_fused"]["distance"]["b_to_a"]
        m = "m" if result.report["scan"]["metric"] else "units"
        line = f"{mesh['triangles']:,} triangles, {'' if mesh['manifold'] else 'not '}manifold"
        lines.append(line + (f"; {format_size(textured.stat().st_size)} with texture" if textured else ""))
        stages = result.report["stages"]
        normal_map = stages.get("texture", {}).get("metrics", {}).get("normal_map")
        if normal_map and normal_map["is_written"]:
            lines.append(f"normal map: {format_shading_errors(normal_map)}")
        details = stages.get("simplify", {}).get("metrics", {}).get("details", {})
        if details.get("proven"):
            bound = format_upper_bound(details["shape_bound_m"])
            lines.append(f"proven to be within {bound} {m} of the mesh before simplification")
        line = f"distance to the fused mesh: {distance['rms_m']:.3g} {m} RMS, "
        line += f"{distance['maximum_m']:.3g} {m} maximum"
        color = (mesh["to_fused"]["color"] or {}).get("b_to_a")
        # With a texture, the colours of the vertices do not matter.
        if color and not textured:
            line += f"; colour error {color['rmse_levels']:.3g} of 255 levels RMS"
        lines.append(line)
    held_out = result.report.get("held_out")
    if held_out and held_out["photos"]:
        lines.append(
            f"{held_out['photos']} photos held out: PSNR {held_out['psnr_affine_db']:.1f} dB "
            f"({held_out['psnr_raw_db']:.1f} raw), SSIM {held_out['ssim']:.3f}, sharpness "
            f"{held_out['sharpness']:.2f}, {held_out['coverage_ratio']:.0%} of their pixels"
        )
    if guess := _describe_guessed_camera(result.report):
        lines.append(guess)
    if mesh is not None and not result.report["scan"]["metric"]:
        lines.append(
            as_typed(
                "lengths are in units, because the scan has no metric scale; "
                "scan.scale=METRES_PER_UNIT sets it"
            )
        )
    placed = [path.relative_to(result.out).parts for stage in result.stages for path in stage.results]
    names = dict.fromkeys(parts[0] + ("/" if parts[1:] else "") for parts in placed)
    pages = [] if result.page is None else [result.page.name]
    lines.append(f"results in {result.out}: {', '.join([*names, 'report.json', *pages])}")
    return "\n".join(lines)


def _describe_guessed_camera(report: Mapping[str, Any]) -> str:
    """Repeat that the result depends on a guessed focal length; empty if it was stated or estimated."""
    found = [*report["scan"]["diagnostics"]]
    found += [one for stage in report["stages"].values() for one in stage.get("diagnostics", ())]
    # A guess has the guessed values. The default camera of a data set has none.
    guesses = [one for one in found if one["code"] == CAMERA_INTRINSICS_GUESSED.name and one.get("values")]
    if not guesses or any(one["code"] == CAMERA_FOCAL_ESTIMATED.name for one in found):
        return ""
    return as_typed(
        "the camera is a guess: if it is wrong, the mesh is bent, and floors and walls appear several times. "
        "Set scan.intrinsics=NAME (such as d435, azure or kinect2) or scan.intrinsics=fx,fy,cx,cy"
    )
