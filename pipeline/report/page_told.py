"""Text and tables of a run's page, from report.json."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.printing import at_most, place_in_words


def told_of(report: Mapping[str, Any]) -> dict[str, Any]:
    """Convert report.json to the report data of `one_file`, warnings first."""
    scan, ran = report.get("scan", {}), report.get("stages", {})
    figures = [
        *scan.get("diagnostics", []),
        *(one for about in ran.values() for one in about.get("diagnostics", [])),
    ]
    warnings = [str(Diagnostic.from_figures(one)) for one in figures if one["severity"] != Severity.INFO]
    tables = []
    if ran:
        rows = [
            [
                stage,
                "cached" if about["cached"] else f"{about['seconds']:.1f} s",
                f"{about['made_in_s']:.1f} s",
                f"{about['peak_memory_mb']:,.0f} MB",
                about["reason"],
            ]
            for stage, about in ran.items()
        ]
        head = ["stage", "this run", "computed in", "memory", "reason"]
        tables.append({"title": "Stages", "head": head, "rows": rows})
    skipped = skipped_in(report)
    if skipped:
        rows = [[frame, reason] for frame, reason in skipped.items()]
        tables.append({"title": "Skipped frames", "head": ["frame", "reason"], "rows": rows})
    texts = []
    if ran:
        texts = [
            {"title": "Versions and digests", "text": _made_of(report)},
            {"title": "All parameters, as TOML", "text": _toml(ran)},
            {"title": "report.json", "text": json.dumps(report, indent=1, ensure_ascii=False)},
        ]
    told = {"warnings": warnings, "tables": tables, "texts": texts, "frames": _frames_in_words(report)}
    return told if scan.get("metric", True) else told | {"unit": "units"}


def skipped_in(report: Mapping[str, Any]) -> dict[str, str]:
    """Return the reasons of skipped frames by frame name.

    A frame may be skipped while reading or by a stage; the first reason counts.
    """
    of_scan = at(report, "scan", "frames_skipped", otherwise=[])
    found = {str(one["frame"]): str(one["reason"]) for one in of_scan}
    for stage, about in report.get("stages", {}).items():
        for one in at(about, "figures", "frames_skipped", otherwise=[]):
            found.setdefault(str(one["frame"]), f"{stage}: {one['reason']}")
    return found


def deviation_tables(
    told: Mapping[str, Any],
    proven: float | None,
    places: Sequence[Mapping[str, Any]],
    title: str = "Deviation of the result from the clean mesh, sampled",
    *,
    is_metric: bool = True,
) -> list[dict[str, Any]]:
    """Make the tables of a deviation: its size, and its worst locations.

    Parameters
    ----------
    told : metrics of `scanloom.Deviations`.
    proven : proven bound in metres; None if there is none.
    places : camera targets of the worst locations, as for `one_file`.
    title : title of the first table.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    per, small, large = (1000, "mm", "m") if is_metric else (1, "units", "units")
    percentiles = told["absolute_percentiles_m"]
    rows = [[f"{p} % are within", f"{per * d:.4g} {small}"] for p, d in percentiles.items()]
    farthest = max((abs(one["distance_m"]) for one in told["worst"]), default=0.0)
    rows.append(["maximum of samples and vertices", f"{per * farthest:.4g} {small}"])
    rows.append(["RMS", f"{per * told['rms_m']:.4g} {small}"])
    if proven is not None:
        rows.append(["proven bound for all points", f"{at_most(per * proven)} {small}"])
    if told["share_within"] is not None:
        bound = f"within the bound of {per * told['tolerance_m']:g} {small}"
        rows.append([bound, f"{told['share_within']:.2%}"])
    if told["delta_e_2000"] is not None:
        rows.append(["mean colour difference ΔE2000", f"{told['delta_e_2000']['mean']:.3g}"])
    return [
        {"title": title, "head": ["", ""], "rows": rows},
        {
            "title": "Largest deviations",
            "head": ["deviation", f"location in scan coordinates, {large}", ""],
            "rows": [
                [f"{per * one['distance_m']:+.3g} {small}", place_in_words(one["point_m"])]
                for one in told["worst"]
            ],
            "places": list(places),
        },
    ]


def at(document: Mapping[str, Any], *names: str, otherwise: Any = None) -> Any:
    """Look up a nested key; `otherwise` if missing or None."""
    found: Any = document
    for name in names:
        found = found.get(name) if isinstance(found, Mapping) else None
    return otherwise if found is None else found


def _frames_in_words(report: Mapping[str, Any]) -> str:
    """Summarise how many frames were read, held out and skipped."""
    read, held_out = at(report, "scan", "frames"), at(report, "held_out", "photos", otherwise=0)
    if read is None:
        return ""
    told = [f"{read:,} frames were read", f"{held_out:,} were held out for evaluation" if held_out else ""]
    skipped = len(skipped_in(report))
    return "; ".join(filter(None, [*told, f"{skipped:,} were skipped" if skipped else ""])) + "."


def _made_of(report: Mapping[str, Any]) -> str:
    """List the versions that made a result, and the SHA-256 of its files."""
    versions = {"scanloom": report.get("scanloom"), **at(report, "libraries", otherwise={})}
    lines = [
        f"made {report.get('created')}",
        *(f"{name} {version}" for name, version in versions.items()),
        "",
    ]
    for files in at(report, "placed", otherwise={}).values():
        lines += (f"{content}  {name}" for name, content in files.items())
    return "\n".join([*lines, f"{report.get('digest')}  report.json without this line", ""])


def _toml(ran: Mapping[str, Any]) -> str:
    lines: list[str] = []
    for about in ran.values():
        for section, values in about.get("params", {}).items():
            lines += ["", f"[{section}]"]
            lines += [f"{key} = {json.dumps(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines).strip() + "\n"
