"""Measured results of simplifiers, and comparisons of tools."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from peers.tools import OURS, TOOLS
from scanloom.stages.surface.topology import Topology

# Fewer triangles increase every error. Results are comparable if ours has at most this many times the
# triangles.
MAX_COUNT_RATIO = 1.01
QUADRIC = {tool.name for tool in TOOLS if tool.is_quadric}


@dataclass(frozen=True)
class SimplifierResult:
    """Measured result of one tool and setting.

    Distances are over the bounding box's diagonal, colour errors in 8-bit levels; None if not available.
    """

    mesh: str
    ratio: float
    tool: str
    setting: str
    triangles: int
    rms: float
    maximum: float
    check: float | None
    color: float | None
    color_note: str
    psnr: float | None
    topology: Topology
    euler_change: int
    turned: int
    edge_mean: float
    edge_spread: float
    angle_low: float
    angle_least: float
    seconds: float
    megabytes: float


def group_by_mesh(rows: list[SimplifierResult]) -> dict[tuple[str, float], list[SimplifierResult]]:
    """Group rows by mesh and ratio, in order of appearance."""
    keys = dict.fromkeys((row.mesh, row.ratio) for row in rows)
    return {key: [row for row in rows if (row.mesh, row.ratio) == key] for key in keys}


def select_colored(rows: list[SimplifierResult]) -> list[SimplifierResult]:
    """Select the rows of meshes with colours."""
    meshes = {row.mesh for row in rows if row.color is not None}
    return [row for row in rows if row.mesh in meshes]


def compare_with_peers(rows: list[SimplifierResult]) -> Iterator[str]:
    """Yield comparisons with the peers for each mesh and ratio.

    They list the peers that we beat, and our shape error over the best peer's.
    """
    for (mesh, ratio), part in group_by_mesh(rows).items():
        own, peers = ([row for row in part if (row.tool == OURS) == yes] for yes in (True, False))
        if not own or not peers:
            continue
        yield f"**{mesh}, {ratio:.0%}**\n"
        for tool in dict.fromkeys(row.tool for row in peers if row.color is not None):
            yield format_peer_comparison(tool, [row for row in peers if row.tool == tool], own)
        dropping = [row for row in peers if row.color is None]
        quadric = [row for row in dropping if row.tool in QUADRIC]
        for some, kind in ((quadric, "quadric tool"), (dropping, "tool")):
            if some:
                best = min(some, key=lambda row: row.rms)
                yield (
                    f"- shape RMS of our {own[0].setting or 'only setting'} is {own[0].rms / best.rms:.2f} "
                    f"times that of {best.tool}, the best {kind} without colours"
                )
        yield ""


def format_peer_comparison(tool: str, rows: list[SimplifierResult], own: list[SimplifierResult]) -> str:
    """Format which of our settings beat each setting of a peer."""
    better = {row.setting: [mine.setting for mine in own if is_better(mine, row)] for row in rows}
    count = sum(map(bool, better.values()))
    each = (f"{name or 'default'} ← {', '.join(ours) or 'none'}" for name, ours in better.items())
    return f"- {tool}: {count} of {len(rows)} beaten ({'; '.join(each)})"


def is_better(mine: SimplifierResult, row: SimplifierResult) -> bool:
    """Check if a result has smaller shape and colour errors.

    It must not have more triangles, within `MAX_COUNT_RATIO`.
    """
    if mine.color is None or row.color is None:
        return False
    return mine.rms < row.rms and mine.color < row.color and mine.triangles <= MAX_COUNT_RATIO * row.triangles


def make_summary_table(rows: list[SimplifierResult]) -> Iterator[str]:
    """Yield a Markdown table with one row per tool.

    Each tool is shown at its best setting for each mesh and ratio, the one with the smallest product of shape
    and colour error. Our default has a row as well; all times are relative to it.
    """
    cells = group_by_mesh(select_colored(rows))
    of_tool = {tool.name: [select_tool(part, tool.name) for part in cells.values()] for tool in TOOLS}
    default = [results[:1] for results in of_tool[OURS]]
    heads = ["", *(f"{mesh} {ratio:.0%}" for mesh, ratio in cells), "non-manifold edges", "CPU time"]
    yield "| " + " | ".join(heads) + " |"
    yield "|---" + "|---:" * (len(heads) - 1) + "|"
    yield format_summary_row(OURS, default, default)
    for name, results in of_tool.items():
        settings = max(map(len, results), default=0)
        if settings and (name, settings) != (OURS, 1):
            note = f", best of {settings} weights" if settings > 1 else ""
            yield format_summary_row(name + note, results, default)


def format_summary_row(
    name: str, results: list[list[SimplifierResult]], default: list[list[SimplifierResult]]
) -> str:
    """Format a tool's row from its results by mesh and ratio."""
    best = [min(some, key=compute_error_product) if some else None for some in results]
    found = [row for row in best if row]
    cells = [name, *("failed" if row is None else format_errors(row) for row in best)]
    cells.append(str(sum(row.topology.nonmanifold_edges for row in found)))
    # Compared over the meshes and ratios for which the tool has a result.
    times = [(row.seconds, ours[0].seconds) for row, ours in zip(best, default, strict=True) if row and ours]
    cells.append(f"{sum(t for t, _ in times) / sum(t for _, t in times):.2g}" if times else "")
    return "| " + " | ".join(cells) + " |"


def select_tool(rows: list[SimplifierResult], tool: str) -> list[SimplifierResult]:
    """Select the rows of a tool."""
    return [row for row in rows if row.tool == tool]


def compute_error_product(row: SimplifierResult) -> float:
    """Multiply shape error by colour error; shape error alone without colours."""
    return row.rms * (1.0 if row.color is None else row.color)


def format_errors(row: SimplifierResult) -> str:
    """Format shape and colour error."""
    return f"{1e5 * row.rms:.1f} / " + ("–" if row.color is None else f"{row.color:.1f}")
