"""Plots of trade-offs and stage durations, as PNG or SVG.

Requires the optional package `matplotlib`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.files.replacing import replacing
from scanloom.stages.simplification.tradeoff import Tradeoff
from scanloom.stages.surface.codes import MACHINE_EXTRA_MISSING

SUFFIXES = (".png", ".svg")

_WIDTH, _DPI = 7.0, 150  # inches, and dots per inch
# Distinguishable with colour-vision deficiency: Okabe and Ito, "Color universal design", 2008.
_BLUE, _ORANGE, _GREEN, _GREY = "#0072b2", "#d55e00", "#009e73", "#999999"
# Errors below this ratio of the maximum count as 0 and are not plotted: they would take up most of a
# logarithmic axis.
_NOTHING = 1e-4


def require_plots() -> None:
    """Raise an error with the package to install if `matplotlib` is missing.

    Raises
    ------
    UsageError
        If `matplotlib` is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UsageError(
            MACHINE_EXTRA_MISSING, "plots require matplotlib", remedy="install scanloom[plot]."
        ) from None


def plot_tradeoff(path: Path, found: Tradeoff) -> None:
    """Plot distances and colour differences over triangle counts, with the suggested count.

    Raises
    ------
    UsageError
        If `matplotlib` is not installed.
    StageError
        If the file cannot be written.
    """
    colored = found.points[0].color_rmse_levels is not None
    figure, parts = _figure(5.6 if colored else 3.8, 2 if colored else 1)
    most = max(point.maximum_m for point in found.points)
    shown = [point for point in found.points if point.maximum_m > _NOTHING * most]
    triangles = [point.triangles for point in shown]
    for name, label, color in (
        ("maximum_m", "maximum", _ORANGE),
        ("percentile_95_m", "95 %", _GREEN),
        ("rms_m", "RMS", _BLUE),
    ):
        distances = [1000 * getattr(point, name) for point in shown]
        parts[0].plot(triangles, distances, marker="o", markersize=3.5, color=color, label=label)
    parts[0].set_ylabel("distance, mm")
    if shown:
        _logarithmic(parts[0], "y", "{x:g}")
        parts[0].legend()
    if colored:
        levels = [point.color_rmse_levels for point in shown]
        parts[1].plot(triangles, levels, marker="o", markersize=3.5, color=_BLUE)
        parts[1].set_ylabel("colour, levels of 255, RMS")
        parts[1].set_ylim(bottom=0)
    for part in parts:
        _logarithmic(part, "x", "{x:,.0f}")
        part.grid(visible=True, color="#e5e5e5")
        if found.suggested is not None:
            part.axvline(found.suggested, color=_GREY, linestyle="--", linewidth=1)
    if found.suggested is not None:
        parts[0].set_title(f"suggested: {found.suggested:,} triangles", fontsize="medium")
    parts[-1].set_xlabel("triangles")
    _write(path, figure)


def plot_seconds(path: Path, seconds: Mapping[str, float], cached: Collection[str] = ()) -> None:
    """Plot the duration of each stage as a bar chart.

    Parameters
    ----------
    path : PNG or SVG file.
    seconds : duration of each stage, in order from the top.
    cached : stages loaded from the cache, drawn in grey.

    Raises
    ------
    UsageError
        If `matplotlib` is not installed.
    StageError
        If the file cannot be written.
    """
    figure, (part,) = _figure(0.9 + 0.36 * len(seconds), 1)
    colors = [_GREY if stage in cached else _BLUE for stage in seconds]
    bars = part.barh(np.arange(len(seconds)), list(seconds.values()), color=colors)
    words = [f"{one:.1f} s{' (from the cache)' if stage in cached else ''}" for stage, one in seconds.items()]
    part.bar_label(bars, words, padding=4)
    part.set_yticks(np.arange(len(seconds)), list(seconds))
    part.invert_yaxis()
    part.margins(x=0.3)
    part.set_xlabel("seconds")
    part.spines[["top", "right"]].set_visible(False)
    _write(path, figure)


def _logarithmic(part: Any, axis: str, words: str) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    part.set(**{f"{axis}scale": "log"})
    which = getattr(part, f"{axis}axis")
    which.set_major_locator(LogLocator(subs=(1, 2, 5)))
    which.set_major_formatter(StrMethodFormatter(words))
    which.set_minor_formatter(NullFormatter())


def _figure(height: float, parts: int) -> tuple[Any, Any]:
    require_plots()
    from matplotlib.figure import Figure

    # Not pyplot, which keeps all figures and may require a display.
    figure = Figure(figsize=(_WIDTH, height), dpi=_DPI, layout="constrained")
    return figure, figure.subplots(parts, 1, sharex=True, squeeze=False)[:, 0]


def _write(path: Path, figure: Any) -> None:
    import matplotlib

    kind = path.suffix.lower().removeprefix(".")
    # Without dates and random ids, equal figures give identical files.
    still = {"svg": {"Date": None}, "png": {}}[kind]
    with matplotlib.rc_context({"svg.hashsalt": "scanloom"}), replacing(path) as part:
        figure.savefig(part, format=kind, metadata=still)
