"""Text and tables of a run's page, from report.json."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.printing import format_position, format_upper_bound

# Depths at which the noise of depth images is listed, metres.
_NOISE_DEPTHS_M = (1.0, 2.0)


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
        tables.append({"title": "Stages", "head": head, "rows": rows, "folded": True})
    skipped = list_skipped_frames(report)
    if skipped:
        rows = [[frame, reason] for frame, reason in skipped.items()]
        tables.append({
            "title": "Skipped frames", "head": ["frame", "reason"], "rows": rows, "folded": True
        })  # fmt: skip
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
    title: str = "Simplification error",
    text: str = "Distance of the result from the refined mesh. Errors of the scan are not included.",
    *,
    is_metric: bool = True,
) -> list[dict[str, Any]]:
    """Make the tables of a deviation: its size, and its worst locations.

    Parameters
    ----------
    deviation : metrics of `scanloom.Deviations`.
    proven_bound : proven bound in metres; None without one.
    targets : camera targets of the worst locations, as for `make_single_file_page`.
    title, text : title and explanation of the first table.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    unit_factor, small, large = (1000, "mm", "m") if is_metric else (1, "units", "units")
    percentiles = deviation["absolute_percentiles_m"]
    rows = [
        [f"{p} % of the surface within", f"{_format_small(unit_factor * d)} {small}"]
        for p, d in percentiles.items()
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
        {"title": title, "text": text, "head": ["", ""], "rows": rows},
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


def make_noise_table(report: Mapping[str, Any], *, is_metric: bool = True) -> dict[str, Any] | None:
    """Make the table of the measured noise of a scan; None without measurements.

    Parameters
    ----------
    report : content of report.json.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    unit_factor, small = (1000, "mm") if is_metric else (1, "units")
    fuse = get_nested(report, "stages", "fuse", "metrics", default={})
    rows = []
    noise = get_surface_noise(report)
    if noise is not None:
        rows.append(["standard deviation of the surface, median", f"{unit_factor * noise:.3g} {small}"])
    constant, quadratic = fuse.get("depth_noise_constant_m"), fuse.get("depth_noise_quadratic_per_m")
    if constant is not None and quadratic is not None and is_metric:
        for z in _NOISE_DEPTHS_M:
            deviation = unit_factor * (float(constant) + float(quadratic) * z * z)
            rows.append([f"noise of depth images at {z:g} m", f"{deviation:.3g} {small}"])
    if fuse.get("voxel_size_m") is not None:
        rows.append(["voxel size", f"{unit_factor * float(fuse['voxel_size_m']):.3g} {small}"])
    score = get_nested(report, "held_out", "psnr_affine_db")
    if score is not None:
        rows.append(["agreement with held-out photos (PSNR)", f"{float(score):.1f} dB"])
    text = (
        "Disagreement of the frames with each other. An error that all frames share, such as a wrong scale, "
        "is not included: check a known length with Measure."
    )
    return {"title": "Scan noise", "text": text, "head": ["", ""], "rows": rows} if rows else None


def get_surface_noise(report: Mapping[str, Any]) -> float | None:
    """Return the median standard deviation of the surface in metres; None if not measured."""
    noise = get_nested(report, "stages", "refine", "metrics", "deviation_median_m")
    return float(noise) if noise else None


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
