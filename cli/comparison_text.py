"""Tables of `compare`; every number has a unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from scanloom.cli.output import format_table
from scanloom.stages.printing import format_position

_WAYS = {"a_to_b": "A to B", "b_to_a": "B to A", "symmetric": "both ways"}
_MEASURES = {"maximum": "maximum", "mean": "mean", "rms": "RMS"}

# Metres. Lengths from this value on are printed in metres, shorter ones in millimetres.
_LONG = 1.0

# Formats a length in the unit of the tables, optionally with a sign.
Length = Callable[..., str]


def comparison_text(metrics: Mapping[str, Any]) -> str:
    """Return the metrics of a comparison as tables."""
    # The same unit in all tables, so that numbers can be compared at a glance.
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
        parts += ["", f"A is a point cloud: distances below its point spacing, {gap}, are not meaningful."]
        if clouds["b"] is None:
            parts += ["`compare B A` measures the exact distances of its points from B."]
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
        return f"{name.upper()}: surface, {samples:,} samples, uniform over its area, and all vertices"
    apart = _fitting(cloud["spacing_m"])
    return f"{name.upper()}: point cloud of {cloud['points']:,} points, all measured; median spacing {apart}"


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
        return "Colours were not compared: A or B has no colours."
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
        rows.append(["signed mean", length(metrics["mean_m"], "+")])
        rows.append(["standard deviation", length(metrics["standard_deviation_m"])])
        rows.append(["minimum", length(metrics["lowest_m"], "+")])
        rows.append(["maximum", length(metrics["highest_m"], "+")])
    worst = metrics["worst"][0]
    rows.append([f"worst, at {_place(worst['point_m'])}", length(worst["distance_m"], signed)])
    text = format_table(rows)
    if not metrics["is_signed"]:
        reason = "has no normals" if metrics["reference_spacing_m"] else "is not consistently oriented"
        text += f"\n\nDeviations are unsigned, because A {reason}."
    if metrics["within_ratio"] is not None:
        text += f"\n\n{metrics['within_ratio']:.2%} within {metrics['tolerance_m']:g} m"
        if metrics["is_signed"]:
            text += f", {metrics['over_ratio']:.2%} over, {metrics['under_ratio']:.2%} under"
        text += "."
    if metrics["delta_e_2000"] is not None:
        of_color = metrics["delta_e_2000"]
        most = of_color["percentiles"]["95"]
        text += (
            f"\n\nColours differ by {of_color['mean']:.3g} ΔE2000 on average; "
            f"95 % by at most {most:.3g} ΔE2000."
        )
    return text


def _alignment_text(moved: Mapping[str, Any], length: Length) -> str:
    return (
        f"B was aligned with A: moved by {length(moved['moved_rms_m'])} RMS and rotated by "
        f"{moved['angle_degrees']:.4g}°; {moved['overlap']:.0%} of B overlaps, with a point-to-plane "
        f"distance of {length(moved['rms_m'])} RMS."
    )


def _places(count: int) -> str:
    return f"{count:,} region" if count == 1 else f"{count:,} regions"


def _change_text(metrics: Mapping[str, Any], length: Length) -> str:
    text = (
        f"New in B: {metrics['new_area_m2']:.4g} m² in {_places(metrics['new_regions'])}; removed from A: "
        f"{metrics['gone_area_m2']:.4g} m² in {_places(metrics['gone_regions'])}; distance threshold "
        f"{length(metrics['distance_m'])}."
    )
    if not metrics["largest"]:
        return text
    rows = [["largest changes", "area", "location"]]
    rows += [[one["kind"], f"{one['area_m2']:.4g} m²", _place(one["point_m"])] for one in metrics["largest"]]
    return f"{text}\n\n{format_table(rows)}"


def _views_text(metrics: Mapping[str, Any]) -> str:
    rows = [["viewpoint", "PSNR", "SSIM", "silhouette IoU", "common pixels"]]
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
        "colors": "The comparison uses unlit colours",
        "shape": "The comparison uses shading only, because A or B has no colours",
    }
    return (
        f"{format_table(rows)}\n\n{compared[metrics['compared']]}. The worst viewpoint is {metrics['worst']}."
    )
