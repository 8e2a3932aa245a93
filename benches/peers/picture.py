"""Picture of shape error against colour error.

One panel for each mesh and ratio, one curve for each tool.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import ticker
from matplotlib.figure import Figure

from peers.results import SimplifierResult, group_by_mesh, select_colored, select_tool
from peers.tools import OURS, TOOLS, Tool

OUR_COLOR = "#d62728"
# Colour and marker of each peer; peers that drop colours have line dashes instead of a marker.
STYLES: dict[str, tuple[str, Any]] = {
    "VTK": ("#1f77b4", "s"),
    "meshoptimizer": ("#2ca02c", "^"),
    "PyMeshLab": ("#9467bd", "D"),
    "Open3D legacy": ("#8c564b", "v"),
    "CGAL Lindstrom–Turk": ("#444444", (0, (1, 1.5))),
    "CGAL Garland–Heckbert": ("#888888", (0, (1, 1.5))),
    "Open3D tensor": ("#888888", (0, (5, 2))),
    "fast-simplification": ("#888888", (0, (5, 2, 1, 2))),
}


def draw_errors(rows: list[SimplifierResult], path: Path) -> None:
    """Draw all coloured meshes; tools that drop colours are vertical lines."""
    panels = group_by_mesh(select_colored(rows))
    ratios = list(dict.fromkeys(ratio for _, ratio in panels))
    names = list(dict.fromkeys(name for name, _ in panels))
    figure = Figure(figsize=(3.1 * len(names), 2.7 * len(ratios) + 0.7))
    axes = figure.subplots(len(ratios), len(names), squeeze=False)
    for (name, ratio), part in panels.items():
        axis = axes[ratios.index(ratio)][names.index(name)]
        draw_panel(axis, part)
        axis.set_title(f"{name}, {ratio:.0%} of the triangles", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("shape: RMS, 1e-5 of the diagonal", fontsize=9)
    for axis in axes[:, 0]:
        axis.set_ylabel("colour: RMSE, 8-bit levels", fontsize=9)
    handles = {
        label: handle
        for axis in axes.flat
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="lower center", ncols=4, fontsize=8.5, frameon=False)
    figure.tight_layout(rect=(0, 0.66 / figure.get_figheight(), 1, 1))
    figure.savefig(path, dpi=130, metadata={"Software": None})


def draw_panel(axis: Any, rows: list[SimplifierResult]) -> None:
    """Draw the panel of one mesh at one ratio."""
    for tool in TOOLS:
        points = sorted(select_tool(rows, tool.name), key=lambda row: get_color_weight(tool, row))
        if not points:
            continue
        shape = [1e5 * row.rms for row in points]
        if tool.name == OURS:
            errors = [row.color for row in points]
            axis.plot(shape, errors, "o-", color=OUR_COLOR, linewidth=2.5, markersize=5, label=OURS, zorder=4)
            default = select_tool(rows, OURS)[0]
            axis.plot(
                1e5 * default.rms, default.color, "*", color=OUR_COLOR, markeredgecolor="black",
                markersize=14, label=f"{OURS}, default", zorder=5, linestyle="none",
            )  # fmt: skip
        elif tool.keeps_color:
            color, marker = STYLES[tool.name]
            errors = [row.color for row in points]
            axis.plot(shape, errors, marker=marker, color=color, linewidth=1.2, markersize=5, label=tool.name)
        else:
            color, dashes = STYLES[tool.name]
            label = f"{tool.name}: no colour"
            axis.axvline(shape[0], color=color, linestyle=dashes, linewidth=1.3, label=label)
    scales = ((axis.set_xscale, axis.xaxis, (1, 2, 5)), (axis.set_yscale, axis.yaxis, (1, 2, 3, 5, 7)))
    for scale, ticks, subs in scales:
        scale("log")
        ticks.set_major_locator(ticker.LogLocator(subs=subs))
        ticks.set_major_formatter(ticker.FormatStrFormatter("%g"))
        ticks.set_minor_formatter(ticker.NullFormatter())
    axis.tick_params(labelsize=8, which="both")
    axis.grid(alpha=0.3)


def get_color_weight(tool: Tool, row: SimplifierResult) -> float:
    """Return the colour weight that a result was made with."""
    return tool.settings[row.setting].get("weight", 0.0)
