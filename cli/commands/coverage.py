"""Command `coverage`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom.cli.options import Changes
from scanloom.cli.output import Output, format_table
from scanloom.cli.paths import require_scan
from scanloom.cli.rendering import as_typed
from scanloom.cli.run_progress import show_run_progress
from scanloom.stages import CoverageParams
from scanloom.stages.printing import format_count, format_position


def coverage(
    folder: Annotated[
        Path, typer.Argument(metavar="OUT", help="Output folder of scanloom run.", show_default=False)
    ],
    coverage: Changes[CoverageParams],
    out: Output,
    scan: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Scan folder, if it was moved since the run.", show_default=False
        ),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Cache of the run. Default: $SCANLOOM_CACHE, or OUT/cache.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Find gaps of a scan and where to capture them.

    Lists holes, unobserved space, and surface that was measured by few frames, obliquely, from far away, or
    inconsistently; the most important first, each with a viewpoint and the nearest frames. OUT gets
    coverage.json, coverage.ply and coverage.glb, the mesh coloured by kind, and report.html shows the same.
    The outer boundary of the scan is not listed.

    Example: scanloom coverage my_mesh
    """
    from scanloom.pipeline.artifacts.file_names import COVERAGE
    from scanloom.pipeline.run.resume import continue_run
    from scanloom.stages.files.documents import read_json

    if scan is not None:
        require_scan(scan)
    with show_run_progress(out) as events:
        result = continue_run(folder, "coverage", coverage, scan=scan, cache_dir=cache, events=events)
    metrics: Any = read_json(result.out / COVERAGE)
    files = [str(path) for stage in result.stages if stage.stage == "coverage" for path in stage.results]
    is_metric = bool(result.report["scan"]["metric"])
    out.result({"output": files, **metrics}, as_typed("\n".join(_lines(metrics, is_metric=is_metric))))


def _lines(metrics: Mapping[str, Any], *, is_metric: bool) -> Sequence[str]:
    """Return the table of gaps and a summary of the surface."""
    m, m2 = ("m", "m²") if is_metric else ("units", "units²")
    places = metrics["places"]
    if not places:
        return ["No gaps: the surface has no holes and is well observed everywhere."]
    rows = [["", "defect", m2, f"location ({m})", f"viewpoint ({m})", "nearest frame", "view of the frame"]]
    for number, one in enumerate(places, 1):
        nearest = one["nearest_frames"][0]
        rows.append(
            [
                str(number),
                one["why"],
                _area(one["area_m2"]),
                format_position(one["point_m"]),
                format_position(one["viewpoint_m"]),
                nearest["frame"],
                nearest["why"],
            ]
        )
    lines = [format_table(rows), ""]
    if metrics["places_omitted"]:
        lines.append(
            f"{metrics['places_omitted']:,} smaller defects are not listed; see coverage.max_defects and "
            "coverage.min_area."
        )
    missing, thin = sum(metrics["missing_m2"].values()), sum(metrics["weakly_observed_m2"].values())
    surface = metrics["surface_m2"]
    lines.append(
        f"{_area(surface)} {m2} of surface, {thin / surface:.0%} of it weakly observed; {_area(missing)} "
        f"{m2} next to space that no frame observed; {format_count(metrics['frames_used'], 'frame')}"
    )
    lines.append(
        f"disagreement of frames, RMS: median {metrics['spread_median_m']:.2g} {m}, "
        f"95th percentile {metrics['spread_95_m']:.2g} {m}"
    )
    return lines


def _area(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"
