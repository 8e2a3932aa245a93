"""Text and tables of a run's page, from report.json."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.printing import format_position, format_upper_bound


def summarize_report(report: Mapping[str, Any]) -> dict[str, Any]:
    """Convert report.json to the report data of `make_single_file_page`, warnings first."""
    scan, stages = report.get("scan", {}), report.get("stages", {})
    metrics = [
        *scan.get("diagnostics", []),
        *(one for about in stages.values() for one in about.get("diagnostics", [])),
    ]
    warnings = [str(Diagnostic.from_dict(one)) for one in metrics if one["severity"] != Severity.INFO]
    tables = []
    if stages:
        rows = [
            [
                stage,
                "cached" if about["cached"] else f"{about['seconds']:.1f} s",
                f"{about['compute_seconds']:.1f} s",
                f"{about['peak_memory_mb']:,.0f} MB",
                about["reason"],
            ]
            for stage, about in stages.items()
        ]
        head = ["stage", "this run", "computed in", "memory", "reason"]
        tables.append({"title": "Stages", "head": head, "rows": rows})
    skipped = list_skipped_frames(report)
    if skipped:
        rows = [[frame, reason] for frame, reason in skipped.items()]
        tables.append({"title": "Skipped frames", "head": ["frame", "reason"], "rows": rows})
    texts = []
    if stages:
        texts = [
            {"title": "Versions and digests", "text": _list_versions(report)},
            {"title": "All parameters, as TOML", "text": _format_toml(stages)},
            {"title": "report.json", "text": json.dumps(report, indent=1, ensure_ascii=False)},
        ]
    report_data = {"warnings": warnings, "tables": tables, "texts": texts, "frames": _describe_frames(report)}
    return report_data if scan.get("metric", True) else report_data | {"unit": "units"}


def list_skipped_frames(report: Mapping[str, Any]) -> dict[str, str]:
    """Return the reasons of skipped frames by frame name.

    A frame may be skipped while reading or by a stage; the first reason counts.
    """
    of_scan = get_nested(report, "scan", "frames_skipped", default=[])
    found = {str(one["frame"]): str(one["reason"]) for one in of_scan}
    for stage, about in report.get("stages", {}).items():
        for one in get_nested(about, "metrics", "frames_skipped", default=[]):
            found.setdefault(str(one["frame"]), f"{stage}: {one['reason']}")
    return found


def make_deviation_tables(
    deviation: Mapping[str, Any],
    proven_bound: float | None,
    targets: Sequence[Mapping[str, Any]],
    title: str = "Deviation of the result from the refined mesh, sampled",
    *,
    is_metric: bool = True,
) -> list[dict[str, Any]]:
    """Make the tables of a deviation: its size, and its worst locations.

    Parameters
    ----------
    deviation : metrics of `scanloom.Deviations`.
    proven_bound : proven bound in metres; None without one.
    targets : camera targets of the worst locations, as for `make_single_file_page`.
    title : title of the first table.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    unit_factor, small, large = (1000, "mm", "m") if is_metric else (1, "units", "units")
    percentiles = deviation["absolute_percentiles_m"]
    rows = [
        [f"{p} % are within", f"{_format_small(unit_factor * d)} {small}"] for p, d in percentiles.items()
    ]
    farthest = max((abs(one["distance_m"]) for one in deviation["worst"]), default=0.0)
    rows.append(["maximum of samples and vertices", f"{unit_factor * farthest:.4g} {small}"])
    rows.append(["RMS", f"{unit_factor * deviation['rms_m']:.4g} {small}"])
    if proven_bound is not None:
        rows.append(
            ["proven bound for all points", f"{format_upper_bound(unit_factor * proven_bound)} {small}"]
        )
    if deviation["within_ratio"] is not None:
        bound = f"within the bound of {unit_factor * deviation['tolerance_m']:g} {small}"
        rows.append([bound, f"{deviation['within_ratio']:.2%}"])
    if deviation["delta_e_2000"] is not None:
        rows.append(["mean colour difference ΔE2000", f"{deviation['delta_e_2000']['mean']:.3g}"])
    return [
        {"title": title, "head": ["", ""], "rows": rows},
        {
            "title": "Largest deviations",
            "head": ["deviation", f"location in scan coordinates, {large}", ""],
            "rows": [
                [f"{unit_factor * one['distance_m']:+.3g} {small}", format_position(one["point_m"])]
                for one in deviation["worst"]
            ],
            "places": list(targets),
        },
    ]


def _format_small(value: float) -> str:
    """Format a distance. Below a thousandth it is 0.000: planar parts differ by rounding errors only."""
    return f"{value:.3f}" if value < 1e-3 else f"{value:.4g}"


def get_nested(document: Mapping[str, Any], *names: str, default: Any = None) -> Any:
    """Look up a nested key; `default` if missing or None."""
    found: Any = document
    for name in names:
        found = found.get(name) if isinstance(found, Mapping) else None
    return default if found is None else found


def _describe_frames(report: Mapping[str, Any]) -> str:
    """Summarise how many frames were read, held out and skipped."""
    read, held_out = get_nested(report, "scan", "frames"), get_nested(report, "held_out", "photos", default=0)
    if read is None:
        return ""
    told = [f"{read:,} frames were read", f"{held_out:,} were held out for evaluation" if held_out else ""]
    skipped = len(list_skipped_frames(report))
    return "; ".join(filter(None, [*told, f"{skipped:,} were skipped" if skipped else ""])) + "."


def _list_versions(report: Mapping[str, Any]) -> str:
    """List the versions that made a result, and the SHA-256 of its files."""
    versions = {"scanloom": report.get("scanloom"), **get_nested(report, "libraries", default={})}
    lines = [
        f"made {report.get('created')}",
        *(f"{name} {version}" for name, version in versions.items()),
        "",
    ]
    for files in get_nested(report, "placed", default={}).values():
        lines += (f"{content}  {name}" for name, content in files.items())
    return "\n".join([*lines, f"{report.get('digest')}  report.json without this line", ""])


def _format_toml(stages: Mapping[str, Any]) -> str:
    lines: list[str] = []
    for about in stages.values():
        for section, values in about.get("params", {}).items():
            lines += ["", f"[{section}]"]
            lines += [f"{key} = {json.dumps(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines).strip() + "\n"
