"""Isolated degenerate triangles, which no method keeps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.simplification.codes import SIMPLIFY_DEGENERATE_REMOVED
from scanloom.stages.simplification.seams.similar import equal_sets, may_have_equal
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import repeats_vertex


def lost_lines(mesh: Mesh) -> NDArray[np.bool_]:
    """Return a mask (m,) of isolated degenerate triangles.

    Two of their vertices are at one position, and no regular triangle shares their edge. Degenerate triangles
    at the poles of a sphere share their edge, so nothing is lost with them. Isolated ones may be far from the
    remaining surface.
    """
    lost = np.zeros(len(mesh.triangles), np.bool_)
    if not (repeats_vertex(mesh.triangles).any() or may_have_equal(mesh.vertices)):
        return lost
    sets = equal_sets(mesh.vertices)
    corners = sets[mesh.triangles].astype(np.int64)
    is_line = repeats_vertex(corners)
    if not is_line.any():
        return lost
    sides = np.sort(corners[~is_line][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    low, high = corners[is_line].min(axis=1), corners[is_line].max(axis=1)
    lost[is_line] = np.where(
        low == high, ~np.isin(low, sides), ~np.isin(low << 32 | high, sides[:, 0] << 32 | sides[:, 1])
    )
    return lost


def report_lost_lines(mesh: Mesh) -> None:
    """Warn about isolated degenerate triangles, which are lost."""
    lost = lost_lines(mesh)
    if lost.any():
        emit(
            SIMPLIFY_DEGENERATE_REMOVED.warning(
                "isolated degenerate triangles were removed, and no bound covers them: "
                "{lost:,} of {count:,}.",
                lost=np.count_nonzero(lost),
                count=len(lost),
            )
        )
