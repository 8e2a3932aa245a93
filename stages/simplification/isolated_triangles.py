"""Isolated degenerate triangles, which no method keeps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.simplification.codes import SIMPLIFY_DEGENERATE_REMOVED
from scanloom.stages.simplification.seams.similar_vertices import (
    group_equal_vertices,
    has_possible_duplicates,
)
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import has_repeated_vertex


def find_isolated_degenerates(mesh: Mesh) -> NDArray[np.bool_]:
    """Return a mask (m,) of isolated degenerate triangles.

    Two of their vertices are at one position, and no regular triangle shares their edge. Degenerate triangles
    at the poles of a sphere share their edge, so nothing is lost with them. Isolated ones may be far from the
    remaining surface.
    """
    is_isolated = np.zeros(len(mesh.triangles), np.bool_)
    if not (has_repeated_vertex(mesh.triangles).any() or has_possible_duplicates(mesh.vertices)):
        return is_isolated
    sets = group_equal_vertices(mesh.vertices)
    corners = sets[mesh.triangles].astype(np.int64)
    is_line = has_repeated_vertex(corners)
    if not is_line.any():
        return is_isolated
    sides = np.sort(corners[~is_line][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    low, high = corners[is_line].min(axis=1), corners[is_line].max(axis=1)
    is_isolated[is_line] = np.where(
        low == high, ~np.isin(low, sides), ~np.isin(low << 32 | high, sides[:, 0] << 32 | sides[:, 1])
    )
    return is_isolated


def report_isolated_degenerates(mesh: Mesh) -> None:
    """Warn about isolated degenerate triangles, which are lost."""
    lost = find_isolated_degenerates(mesh)
    if lost.any():
        emit(
            SIMPLIFY_DEGENERATE_REMOVED.warning(
                "isolated degenerate triangles were removed, and no bound covers them: "
                "{lost:,} of {count:,}.",
                lost=np.count_nonzero(lost),
                count=len(lost),
            )
        )
