"""What stands in the way of fewer triangles, where that is most of the edges that are left."""

from __future__ import annotations

from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.simplification.codes import SIMPLIFY_CROWDED
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.surface.edges import edges_of

# Where a larger share of the edges may not collapse for one reason, little is left to choose. A street of 1.1
# million triangles with 5,439 holes: 11 % of them for its topology at a tenth of the triangles, 65 % at a
# twenty-fifth.
_CROWDED = 0.5


def report_crowded_by_topology(result: Simplified[Any]) -> None:
    """Warn if most edges stand for holes, handles and loose pieces."""
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
    """Warn if most edges are between vertices that must stay, and nothing else is left."""
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
    """Return what share of the edges these rules refused; 0 where it is clear that this is less than half."""
    count, triangles = sum(result.refused.get(rule, 0) for rule in rules), result.mesh.triangles
    # There are at least half as many edges as sides of triangles.
    if count <= _CROWDED * 1.5 * len(triangles):
        return 0.0
    return count / len(edges_of(triangles, len(result.mesh.vertices)).ends)
