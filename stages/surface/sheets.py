"""Sheets: a surface taken apart where it is no manifold, so that each of them is an oriented one."""

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
    """Triangles that are joined where two of them, of like orientation, meet at an edge, and nowhere else.

    Attributes
    ----------
    triangles : (k, 3) int32, numbers of the sheets' own vertices.
    triangle_source : (k,) int32, the triangle of the input each was; those with two corners in one set are
        left out.
    vertex_source : (p,) int32, a vertex of the input that each one is.
    touches : (p,) bool, vertices where sheets touch: if one moved, they would come apart.
    sets : (n,) the set that each vertex of the input is in; vertices of one set are one.
    """

    triangles: Triangles
    triangle_source: NDArray[np.int32]
    vertex_source: NDArray[np.int32]
    touches: NDArray[np.bool_]
    sets: Ids


def taken_apart(triangles: Triangles, sets: Ids) -> Sheets:
    """Take a surface apart where more than two triangles meet at an edge, or fans of them at a vertex.

    Parameters
    ----------
    triangles : (m, 3).
    sets : (n,) numbers from 0 to n - 1; vertices of one set are one.
    """
    welded = _kernels.weld_sheets(sets.astype(np.int32), triangles)
    vertex_source = np.empty(len(welded.touches), np.int32)
    vertex_source[welded.triangles] = triangles[welded.triangle_source]
    return Sheets(welded.triangles, welded.triangle_source, vertex_source, welded.touches, sets)
