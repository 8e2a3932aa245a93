"""Plots of trade-offs and stage durations, as PNG or SVG.

Requires the optional package `matplotlib`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.simplification.tradeoff import Tradeoff
from scanloom.stages.surface.codes import MACHINE_EXTRA_MISSING

SUFFIXES = (".png", ".svg")

_WIDTH, _DPI = 7.0, 150  # inches, and dots per inch
# Distinguishable with colour-vision deficiency: Okabe and Ito, "Color universal design", 2008.
_BLUE, _ORANGE, _GREEN, _GREY = "#0072b2", "#d55e00", "#009e73", "#999999"
# Errors below this ratio of the maximum count as 0 and are not plotted: they would take up most of a
# logarithmic axis.
_MIN_PLOTTED_RATIO = 1e-4


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


def plot_tradeoff(path: Path, tradeoff: Tradeoff) -> None:
    """Plot distances and colour differences over triangle counts, with the suggested count.

    Raises
    ------
    UsageError
        If `matplotlib` is not installed.
    StageError
        If the file cannot be written.
    """
    colored = tradeoff.points[0].color_rmse_levels is not None
    figure, axes = _create_figure(5.6 if colored else 3.8, 2 if colored else 1)
    max_distance = max(point.maximum_m for point in tradeoff.points)
    plotted_points = [
        point for point in tradeoff.points if point.maximum_m > _MIN_PLOTTED_RATIO * max_distance
    ]
    triangles = [point.triangles for point in plotted_points]
    for name, label, color in (
        ("maximum_m", "maximum", _ORANGE),
        ("percentile_95_m", "95 %", _GREEN),
        ("rms_m", "RMS", _BLUE),
    ):
        distances = [1000 * getattr(point, name) for point in plotted_points]
        axes[0].plot(triangles, distances, marker="o", markersize=3.5, color=color, label=label)
    axes[0].set_ylabel("distance, mm")
    if plotted_points:
        _set_log_scale(axes[0], "y", "{x:g}")
        axes[0].legend()
    if colored:
        levels = [point.color_rmse_levels for point in plotted_points]
        axes[1].plot(triangles, levels, marker="o", markersize=3.5, color=_BLUE)
        axes[1].set_ylabel("colour, levels of 255, RMS")
        axes[1].set_ylim(bottom=0)
    for part in axes:
        _set_log_scale(part, "x", "{x:,.0f}")
        part.grid(visible=True, color="#e5e5e5")
        if tradeoff.suggested_triangles is not None:
            part.axvline(tradeoff.suggested_triangles, color=_GREY, linestyle="--", linewidth=1)
    if tradeoff.suggested_triangles is not None:
        axes[0].set_title(f"suggested: {tradeoff.suggested_triangles:,} triangles", fontsize="medium")
    axes[-1].set_xlabel("triangles")
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
    figure, (part,) = _create_figure(0.9 + 0.36 * len(seconds), 1)
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


def _set_log_scale(part: Any, axis: str, words: str) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    part.set(**{f"{axis}scale": "log"})
    which = getattr(part, f"{axis}axis")
    which.set_major_locator(LogLocator(subs=(1, 2, 5)))
    which.set_major_formatter(StrMethodFormatter(words))
    which.set_minor_formatter(NullFormatter())


def _create_figure(height: float, parts: int) -> tuple[Any, Any]:
    require_plots()
    from matplotlib.figure import Figure

    # Not pyplot, which keeps references to all figures and may require a display.
    figure = Figure(figsize=(_WIDTH, height), dpi=_DPI, layout="constrained")
    return figure, figure.subplots(parts, 1, sharex=True, squeeze=False)[:, 0]


def _write(path: Path, figure: Any) -> None:
    import matplotlib

    kind = path.suffix.lower().removeprefix(".")
    # Without dates and random ids, equal figures give identical files.
    metadata = {"svg": {"Date": None}, "png": {}}[kind]
    with matplotlib.rc_context({"svg.hashsalt": "scanloom"}), write_file_atomically(path) as part:
        figure.savefig(part, format=kind, metadata=metadata)
