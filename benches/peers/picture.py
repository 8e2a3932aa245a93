"""The picture: shape error against colour error, a panel a mesh and ratio, a curve a tool."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import ticker
from matplotlib.figure import Figure

from peers.tools import OURS, TOOLS

MARKERS = "osD^v<>Pd"


def draw(rows: list[Any], path: Path) -> None:
    """Draw rows that have colours; tools that drop colours are a line at their shape error."""
    colored = {row.mesh for row in rows if row.color is not None}
    names = [name for name in dict.fromkeys(row.mesh for row in rows) if name in colored]
    ratios = list(dict.fromkeys(row.ratio for row in rows))
    figure = Figure(figsize=(3.6 * len(names), 3.2 * len(ratios)))
    axes = figure.subplots(len(ratios), len(names), squeeze=False)
    for column, name in enumerate(names):
        for line, ratio in enumerate(ratios):
            axis = axes[line][column]
            panel(axis, [row for row in rows if (row.mesh, row.ratio) == (name, ratio)])
            axis.set_title(f"{name}, {ratio:.0%} of the triangles", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("shape RMS, 1e-5 of the diagonal", fontsize=8)
    for axis in axes[:, 0]:
        axis.set_ylabel("colour RMSE, 8-bit levels", fontsize=8)
    handles = {
        label: handle
        for axis in axes.flat
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    rows_of_legend = -(-len(handles) // 4)
    figure.legend(handles.values(), handles.keys(), loc="lower center", ncols=4, fontsize=8, frameon=False)
    figure.tight_layout(rect=(0, 0.03 * rows_of_legend, 1, 1))
    figure.savefig(path, dpi=100, metadata={"Software": None})


def panel(axis: Any, rows: list[Any]) -> None:
    """Draw one mesh at one ratio."""
    for number, tool in enumerate(TOOLS):
        mine = [row for row in rows if row.tool == tool.name]
        color = "black" if tool.name == OURS else f"C{number}"
        shape = [1e5 * row.rms for row in mine]
        if not mine:
            continue
        if tool.keeps_color:
            axis.plot(
                shape,
                [row.color for row in mine],
                marker=MARKERS[number],
                color=color,
                linewidth=2 if tool.name == OURS else 1,
                markersize=4,
                label=tool.name,
                zorder=3 if tool.name == OURS else 2,
            )
        else:
            axis.axvline(shape[0], color=color, linestyle=":", linewidth=1, label=f"{tool.name} (no colour)")
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axis.xaxis.set_minor_formatter(ticker.NullFormatter())
    axis.tick_params(labelsize=7, which="both")
    axis.grid(alpha=0.3, which="both")
