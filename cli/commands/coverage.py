"""The command `coverage`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom.cli.options import Changes
from scanloom.cli.output import Output, table_of
from scanloom.cli.paths import require_scan
from scanloom.cli.watch import watching
from scanloom.stages import CoverageParams
from scanloom.stages.printing import counted, place_in_words


def coverage(
    folder: Annotated[
        Path, typer.Argument(metavar="OUT", help="Output folder of scanloom run.", show_default=False)
    ],
    params: Changes[CoverageParams],
    out: Output,
    scan: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Where the scan is now, if it was moved since the run.", show_default=False
        ),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Cache of the run; $SCANLOOM_CACHE, or OUT/cache, if not given.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Tell what is missing in a scan: where to go again, why, and from where to look.

    Holes in the surface, space that no frame saw (behind furniture, the far side of things), and surface that
    few frames measured, only obliquely, only from far, or each elsewhere; the most important first, with the
    frames that came nearest to seeing it. OUT then also holds coverage.json, coverage.ply and coverage.glb,
    the mesh in colours of what is missing, and report.html shows the same. Where the scan just ends is no
    place of the list.

    Example: scanloom coverage my_mesh
    """
    from scanloom.pipeline.artifacts.file_names import COVERAGE
    from scanloom.pipeline.run.again import run_again
    from scanloom.stages.files.documents import read_json

    if scan is not None:
        require_scan(scan)
    with watching(out) as events:
        result = run_again(folder, "coverage", params, scan=scan, cache_dir=cache, events=events)
    figures: Any = read_json(result.out / COVERAGE)
    files = [str(path) for stage in result.stages if stage.stage == "coverage" for path in stage.results]
    is_metric = bool(result.report["scan"]["metric"])
    out.result({"output": files, **figures}, "\n".join(_lines(figures, is_metric=is_metric)))


def _lines(figures: Mapping[str, Any], *, is_metric: bool) -> Sequence[str]:
    """Return what is told a person: a table of the places, and what the surface is like."""
    m, m2 = ("m", "m²") if is_metric else ("units", "units²")
    places = figures["places"]
    if not places:
        return ["nothing is missing: the surface has no holes, and all of it was seen well."]
    rows = [["", "what", m2, f"at ({m})", f"look from ({m})", "nearest frame", "which"]]
    for number, one in enumerate(places, 1):
        nearest = one["nearest_frames"][0]
        rows.append(
            [
                str(number),
                one["why"],
                _area(one["area_m2"]),
                place_in_words(one["point_m"]),
                place_in_words(one["look_from_m"]),
                nearest["frame"],
                nearest["why"],
            ]
        )
    lines = [table_of(rows), ""]
    if figures["places_left_out"]:
        lines.append(
            f"{figures['places_left_out']:,} smaller places are not told; see --places and --least-area."
        )
    missing, thin = sum(figures["missing_m2"].values()), sum(figures["thin_m2"].values())
    surface = figures["surface_m2"]
    lines.append(
        f"{_area(missing)} {m2} open to what no frame saw, beside {_area(surface)} {m2} of surface, of which "
        f"{thin / surface:.0%} was hardly seen; {counted(figures['frames_used'], 'frame')}"
    )
    lines.append(
        f"frames are within {figures['spread_median_m']:.2g} {m} of half of what they measured, RMS, "
        f"and within {figures['spread_95_m']:.2g} {m} of 95 % of it"
    )
    return lines


def _area(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"
