"""Decomposition of a non-manifold surface into oriented manifold sheets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.surface.mesh import Triangles

Ids = NDArray[np.integer[Any]]


@dataclass(frozen=True, eq=False)
class Sheets:
    """Triangles connected only across edges with two consistently oriented triangles.

    Attributes
    ----------
    triangles : (k, 3) int32, indices of the sheets' vertices.
    triangle_source : (k,) int32, input triangle of each triangle. Triangles with two corners in one set are
        dropped.
    vertex_source : (p,) int32, an input vertex at each sheet vertex.
    is_contact : (p,) bool, True for vertices where sheets touch; moving one would open a crack.
    weld_sets : (n,) set index of each input vertex; vertices of one set count as one.
    """

    triangles: Triangles
    triangle_source: NDArray[np.int32]
    vertex_source: NDArray[np.int32]
    is_contact: NDArray[np.bool_]
    weld_sets: Ids


def cut_into_sheets(triangles: Triangles, sets: Ids) -> Sheets:
    """Cut a surface at non-manifold edges and vertices.

    Parameters
    ----------
    triangles : (m, 3) vertex indices.
    sets : (n,) set index of each vertex, 0 to n - 1; vertices of one set count as one.
    """
    welded = _kernels.weld_sheets(sets.astype(np.int32), triangles)
    vertex_source = np.empty(len(welded.touches), np.int32)
    vertex_source[welded.triangles] = triangles[welded.triangle_source]
    return Sheets(welded.triangles, welded.triangle_source, vertex_source, welded.touches, sets)
