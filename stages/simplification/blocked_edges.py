"""Warnings about one rule that blocks most of the remaining edges."""

from __future__ import annotations

from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.simplification.codes import SIMPLIFY_EDGES_BLOCKED
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.surface.edges import build_edges

# Ratio of blocked edges above which few edges remain to choose from. In a street with 1.1 million triangles
# and 5,439 holes, the topology blocks 11 % of the edges at a tenth of the triangles, and 65 % at a
# twenty-fifth.
_MAX_BLOCKED_RATIO = 0.5


def report_topology_blocking(result: SimplificationResult[Any]) -> None:
    """Warn if holes, handles and small components block most edges."""
    ratio = compute_refused_ratio(result, "topology", "bridge")
    if ratio > _MAX_BLOCKED_RATIO:
        emit(
            SIMPLIFY_EDGES_BLOCKED.warning(
                "{share:.0%} of the remaining edges belong to holes, handles and small "
                "components, which are preserved, so the other surfaces lost more detail "
                "than necessary",
                remedy="fill or remove small ones first (clean.fill_holes and "
                "clean.min_island_area), or keep more triangles.",
                share=ratio,
            )
        )


def report_lock_blocking(result: SimplificationResult[Any]) -> None:
    """Warn if most remaining edges connect locked vertices."""
    ratio = compute_refused_ratio(result, "locked")
    if result.stopped_by == "bounds" and ratio > _MAX_BLOCKED_RATIO:
        emit(
            SIMPLIFY_EDGES_BLOCKED.warning(
                "{share:.0%} of the remaining edges cannot collapse, because they are locked "
                "or at contacts between sheets, such as double faces and stacked parts.",
                remedy="Run clean first: it removes double faces and separates other contacts.",
                share=min(ratio, 1),
            )
        )


def compute_refused_ratio(result: SimplificationResult[Any], *rules: str) -> float:
    """Compute the ratio of remaining edges whose collapse was refused by the given rules.

    Returns 0 without counting the edges if the ratio is clearly below one half.
    """
    count, triangles = sum(result.refused.get(rule, 0) for rule in rules), result.mesh.triangles
    # A mesh has at least half as many edges as triangle sides. This avoids counting the edges.
    if count <= _MAX_BLOCKED_RATIO * 1.5 * len(triangles):
        return 0.0
    return count / len(build_edges(triangles, len(result.mesh.vertices)).ends)
