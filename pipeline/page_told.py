"""What the page of a run tells in words and tables, from its report.json."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from stages.printing import at_most, place_in_words


def told_of(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return what report.json says, warnings first, as `one_file` takes it."""
    scan, ran = report.get("scan", {}), report.get("stages", {})
    warnings = [str(text) for text in scan.get("warnings", [])]
    for stage, about in ran.items():
        said = [*at(about, "figures", "warnings", otherwise=[]), *about.get("unmet", [])]
        warnings += [f"{stage}: {text}" for text in said]
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
        head = ["stage", "this run", "when it was made", "memory", "why it ran"]
        tables.append({"title": "Stages", "head": head, "rows": rows})
    skipped = scan.get("frames_skipped", [])
    if skipped:
        rows = [[one["frame"], one["reason"]] for one in skipped]
        tables.append({"title": "Frames that were skipped", "head": ["frame", "why"], "rows": rows})
    texts = []
    if ran:
        texts = [
            {"title": "All parameters, as TOML", "text": _toml(ran)},
            {"title": "report.json", "text": json.dumps(report, indent=1, ensure_ascii=False)},
        ]
    return {"warnings": warnings, "tables": tables, "texts": texts}


def deviation_tables(
    told: Mapping[str, Any],
    proven: float | None,
    places: Sequence[Mapping[str, Any]],
    title: str = "Deviation of the result from the clean mesh, by samples",
) -> list[dict[str, Any]]:
    """Return tables of a deviation: how large it is, and its worst places, which the page can fly to.

    Parameters
    ----------
    told : the figures of `stages.Deviations`.
    proven : metres that no point is farther off than; None where nothing is proven.
    places : of the worst, as `one_file` takes them.
    title : of the first table.
    """
    rows = [[f"{p} % are within", f"{1000 * d:.4g} mm"] for p, d in told["absolute_percentiles_m"].items()]
    rows.append(["RMS", f"{1000 * told['rms_m']:.4g} mm"])
    if proven is not None:
        rows.append(["proven: no point is farther off than", f"{at_most(1000 * proven)} mm"])
    if told["share_within"] is not None:
        rows.append([f"within the bound of {1000 * told['tolerance_m']:g} mm", f"{told['share_within']:.2%}"])
    if told["delta_e_2000"] is not None:
        rows.append(["ΔE2000 of colours, on average", f"{told['delta_e_2000']['mean']:.3g}"])
    return [
        {"title": title, "head": ["", ""], "rows": rows},
        {
            "title": "Where it is farthest off",
            "head": ["deviation", "at, in the axes of the scan, m", ""],
            "rows": [
                [f"{1000 * one['distance_m']:+.3g} mm", place_in_words(one["point_m"])]
                for one in told["worst"]
            ],
            "places": list(places),
        },
    ]


def at(document: Mapping[str, Any], *names: str, otherwise: Any = None) -> Any:
    """Return what stands in a document under names in names; else `otherwise`."""
    found: Any = document
    for name in names:
        found = found.get(name) if isinstance(found, Mapping) else None
    return otherwise if found is None else found


def _toml(ran: Mapping[str, Any]) -> str:
    lines: list[str] = []
    for about in ran.values():
        for section, values in about.get("params", {}).items():
            lines += ["", f"[{section}]"]
            lines += [f"{key} = {json.dumps(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines).strip() + "\n"
