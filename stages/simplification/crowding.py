"""Warnings about one rule that blocks most of the remaining edges."""

from __future__ import annotations

from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.simplification.codes import SIMPLIFY_CROWDED
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.surface.edges import edges_of

# Ratio of blocked edges above which few edges remain to choose from. In a street with 1.1 million triangles
# and 5,439 holes, the topology blocks 11 % of the edges at a tenth of the triangles, and 65 % at a
# twenty-fifth.
_CROWDED = 0.5


def report_crowded_by_topology(result: Simplified[Any]) -> None:
    """Warn if holes, handles and small components block most edges."""
    share = share_of_edges(result, "topology", "bridge")
    if share > _CROWDED:
        emit(
            SIMPLIFY_CROWDED.warning(
                "{share:.0%} of the edges that are left stand for holes, handles and loose pieces, which "
                "all stay, so that the rest lost more than it had to",
                remedy="fill or remove small ones first (fill_holes and min_island_area of clean), or keep "
                "more triangles.",
                share=share,
            )
        )


def report_crowded_by_locks(result: Simplified[Any]) -> None:
    """Warn if most remaining edges connect locked vertices."""
    share = share_of_edges(result, "locked")
    if result.stopped_by == "bounds" and share > _CROWDED:
        emit(
            SIMPLIFY_CROWDED.warning(
                "{share:.0%} of the edges that are left lie where sheets touch that cannot be joined, as "
                "doubled faces do and parts that stand on each other, or are locked; they all stay.",
                remedy="Run clean first: it takes doubled faces away and lets the others move.",
                share=min(share, 1),
            )
        )


def share_of_edges(result: Simplified[Any], *rules: str) -> float:
    """Compute the ratio of remaining edges that some rules refused.

    The result is 0 if the ratio is clearly below one half.
    """
    count, triangles = sum(result.refused.get(rule, 0) for rule in rules), result.mesh.triangles
    # A mesh has at least half as many edges as triangle sides. This avoids counting the edges.
    if count <= _CROWDED * 1.5 * len(triangles):
        return 0.0
    return count / len(edges_of(triangles, len(result.mesh.vertices)).ends)
