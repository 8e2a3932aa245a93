"""Tables of `compare`, with a unit at every number."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from scanloom.cli.output import format_table
from scanloom.stages.printing import format_position

_WAYS = {"a_to_b": "A to B", "b_to_a": "B to A", "symmetric": "both ways"}
_MEASURES = {"maximum": "maximum", "mean": "mean", "rms": "RMS"}

# Lengths from here on are printed in metres, shorter ones in millimetres.
_LONG = 1.0

# A length in the unit of the tables, with a sign if that is wanted.
Length = Callable[..., str]


def comparison_text(metrics: Mapping[str, Any]) -> str:
    """Return the metrics of a comparison as tables."""
    # Of one unit in all tables, so that numbers are compared at a glance.
    length = _metres if metrics["distance"]["symmetric"]["maximum_m"] >= _LONG else _millimetres
    clouds = metrics.get("clouds", {"a": None, "b": None})
    parts = [
        *(_compared(name, clouds[name], metrics["samples_per_side"]) for name in "ab"),
        "",
        _distance_text(metrics, length),
        "",
        _color_text(metrics["color"]),
        "",
        _deviation_text(metrics["deviation"], length),
    ]
    if clouds["a"] is not None:
        gap = _fitting(clouds["a"]["spacing_m"])
        parts += ["", f"A is a cloud: a distance below {gap}, as its points are apart, is as good as none."]
        if clouds["b"] is None:
            parts += ["The other way round, compare B A, its points are measured from B exactly."]
    if metrics["alignment"] is not None:
        parts += ["", _alignment_text(metrics["alignment"], length)]
    if metrics["change"] is not None:
        parts += ["", _change_text(metrics["change"], length)]
    if metrics["views"] is not None:
        parts += ["", _views_text(metrics["views"])]
    return "\n".join(parts)


def _metres(value: float, sign: str = "") -> str:
    return f"{value:{sign}.4g} m"


def _millimetres(value: float, sign: str = "") -> str:
    return f"{1000 * value:{sign}.4g} mm"


def _fitting(value: float) -> str:
    return (_metres if value >= _LONG else _millimetres)(value)


def _place(point: Any) -> str:
    return f"({format_position(point)}) m"


def _compared(name: str, cloud: Mapping[str, Any] | None, samples: int) -> str:
    if cloud is None:
        return f"{name.upper()}: surface, {samples:,} samples spread evenly over its area, and its vertices"
    apart = _fitting(cloud["spacing_m"])
    return (
        f"{name.upper()}: cloud of {cloud['points']:,} points, all of them measured; {apart} apart (median)"
    )


def _distance_text(metrics: Mapping[str, Any], length: Length) -> str:
    rows = [["distance", *_MEASURES.values(), *(f"{name} / diagonal" for name in _MEASURES.values())]]
    for key, way in _WAYS.items():
        of = metrics["distance"][key]
        lengths = [length(of[f"{name}_m"]) for name in _MEASURES]
        shares = [f"{100 * of[f'{name}_relative']:.3g} %" for name in _MEASURES]
        rows.append([way, *lengths, *shares])
    return f"{format_table(rows)}\n\nThe diagonal of A is {_metres(metrics['diagonal_m'])}."


def _color_text(color: Mapping[str, Any] | None) -> str:
    if color is None:
        return "No colours compared: A or B has none."
    rows = [["colour, of 255 levels", "RMSE", "PSNR", "maximum"]]
    for key, way in _WAYS.items():
        of = color[key]
        rows.append([
            way,
            f"{of['rmse_levels']:.3g} levels",
            "equal" if of["psnr_db"] is None else f"{of['psnr_db']:.1f} dB",
            f"{of['maximum_levels']:.3g} levels",
        ])  # fmt: skip
    return format_table(rows)


def _deviation_text(metrics: Mapping[str, Any], length: Length) -> str:
    signed = "+" if metrics["is_signed"] else ""
    what = "points" if metrics["is_cloud"] else "area"
    rows = [["deviation of B from A", ""]]
    rows += [
        [f"{p} % of its {what} is within", length(d)] for p, d in metrics["absolute_percentiles_m"].items()
    ]
    rows.append(["RMS", length(metrics["rms_m"])])
    if metrics["is_signed"]:
        rows.append(["mean, with signs", length(metrics["mean_m"], "+")])
        rows.append(["standard deviation", length(metrics["standard_deviation_m"])])
        rows.append(["lowest", length(metrics["lowest_m"], "+")])
        rows.append(["highest", length(metrics["highest_m"], "+")])
    worst = metrics["worst"][0]
    rows.append([f"worst, at {_place(worst['point_m'])}", length(worst["distance_m"], signed)])
    text = format_table(rows)
    if not metrics["is_signed"]:
        lacks = (
            "normals, which would tell sides" if metrics["reference_spacing_m"] else "side that it looks to"
        )
        text += f"\n\nWithout signs: A has no {lacks}."
    if metrics["within_ratio"] is not None:
        text += f"\n\n{metrics['within_ratio']:.2%} within {metrics['tolerance_m']:g} m"
        if metrics["is_signed"]:
            text += f", {metrics['over_ratio']:.2%} over, {metrics['under_ratio']:.2%} under"
        text += "."
    if metrics["delta_e_2000"] is not None:
        of_color = metrics["delta_e_2000"]
        most = of_color["percentiles"]["95"]
        text += f"\n\nColours differ by {of_color['mean']:.3g} ΔE2000 on average; 95 % by {most:.3g} at most."
    return text


def _alignment_text(moved: Mapping[str, Any], length: Length) -> str:
    return (
        f"B was moved onto A by {length(moved['moved_rms_m'])} RMS, and turned by "
        f"{moved['angle_degrees']:.4g}°; {moved['overlap']:.0%} of it has a partner, whose plane is "
        f"{length(moved['rms_m'])} away (RMS)."
    )


def _places(count: int) -> str:
    return f"{count:,} place" if count == 1 else f"{count:,} places"


def _change_text(metrics: Mapping[str, Any], length: Length) -> str:
    text = (
        f"New in B: {metrics['new_area_m2']:.4g} m² in {_places(metrics['new_regions'])}; gone of A: "
        f"{metrics['gone_area_m2']:.4g} m² in {_places(metrics['gone_regions'])}; farther than "
        f"{length(metrics['distance_m'])} from the other."
    )
    if not metrics["largest"]:
        return text
    rows = [["largest changes", "area", "in the middle"]]
    rows += [[one["kind"], f"{one['area_m2']:.4g} m²", _place(one["point_m"])] for one in metrics["largest"]]
    return f"{text}\n\n{format_table(rows)}"


def _views_text(metrics: Mapping[str, Any]) -> str:
    rows = [["drawn", "PSNR", "SSIM", "silhouettes shared", "pixels of both"]]
    rows += [
        [
            one["viewpoint"],
            "equal" if one["psnr_db"] is None else f"{one['psnr_db']:.1f} dB",
            "–" if one["ssim"] is None else f"{one['ssim']:.4f}",
            f"{100 * one['silhouette_iou']:.2f} %",
            f"{one['pixels_compared']:,}",
        ]
        for one in [*metrics["each"], {**metrics, "viewpoint": "all"}]
    ]
    compared = {
        "colors": "Their colours are compared, without any light",
        "shape": "Shading alone is compared, for A or B has no colours",
    }
    return f"{format_table(rows)}\n\n{compared[metrics['compared']]}. The worst is {metrics['worst']}."
