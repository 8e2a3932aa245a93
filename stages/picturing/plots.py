"""Plots of figures, as PNG or SVG: of a tradeoff, and of the seconds of stages.

By `matplotlib`, which is an extra.
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

_WIDTH, _DPI = 7.0, 150  # inches, and pixels for each
# Told apart also by eyes that mix up red and green: Okabe and Ito, "Color universal design", 2008.
_BLUE, _ORANGE, _GREEN, _GREY = "#0072b2", "#d55e00", "#009e73", "#999999"
# What is off by less than this share of the worst is not off: it would take most of a logarithmic axis.
_NOTHING = 1e-4


def require_plots() -> None:
    """Say what to install where the library is not there.

    Raises
    ------
    UsageError
        If `matplotlib` is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UsageError(
            MACHINE_EXTRA_MISSING, "plots are drawn by matplotlib", remedy="install scanloom[plot]."
        ) from None


def plot_tradeoff(path: Path, found: Tradeoff) -> None:
    """Draw distances and colour differences over the number of triangles, and what is suggested.

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
    """Draw a bar for the seconds of each stage, in order from above; those that were cached in grey.

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
    words = [
        f"{one:.1f} s{', when it was made' if stage in cached else ''}" for stage, one in seconds.items()
    ]
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

    # Not pyplot's, which keeps every figure, and may ask for a window.
    figure = Figure(figsize=(_WIDTH, height), dpi=_DPI, layout="constrained")
    return figure, figure.subplots(parts, 1, sharex=True, squeeze=False)[:, 0]


def _write(path: Path, figure: Any) -> None:
    import matplotlib

    kind = path.suffix.lower().removeprefix(".")
    # Equal figures give equal files.
    still = {"svg": {"Date": None}, "png": {}}[kind]
    with matplotlib.rc_context({"svg.hashsalt": "scanloom"}), replacing(path) as part:
        figure.savefig(part, format=kind, metadata=still)
