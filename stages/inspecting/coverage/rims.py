"""Holes within a surface: rims of its border, and what would close them.

The outline of a piece is a closed border as well, and so is where a scan ends. A cap over a hole faces as the
triangles around it do, one over an outline faces the other way; and a rim that winds through a whole scan has
no cap that could be called one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.borders import Border
from scanloom.stages.inspecting.coverage.views import Floats

# Of the angle between a cap and the triangles around it, the least cosine: at the open end of a tube they
# stand at right angles.
_FACING = -0.5
# Of the triangles of a cap, which share of their area does not cancel out: less has no side.
_FLAT = 0.6
# Edges of the mesh: what is narrower is a crack, not a hole.
_WIDTH = 3.0


@dataclass(frozen=True, eq=False)
class Cap:
    """What would close a hole: triangles between its rim and the middle of it.

    Attributes
    ----------
    corners : (k, 3, 3) float64 of the triangles, metres, in the axes of the mesh.
    area : m².
    normal : (3,) unit, as the surface around it faces.
    """

    corners: Floats
    area: float
    normal: Floats


def caps(border: Border, edge: float, least_area: float) -> list[Cap]:
    """Return caps of the holes within an oriented manifold.

    Parameters
    ----------
    border : of all of it.
    edge : metres, the median of the mesh.
    least_area : m²; smaller ones are left out.
    """
    found = []
    for loop in _loops(border):
        rim = border.ends[loop]
        after = np.roll(rim, -1, axis=0)
        corners = np.stack([rim, after, np.broadcast_to(rim.mean(axis=0), rim.shape)], axis=1)
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        total = doubled.sum(axis=0)
        area = float(np.linalg.norm(total)) / 2
        perimeter = float(np.linalg.norm(after - rim, axis=1).sum())
        if area < max(least_area, 0.5 * _WIDTH * edge * perimeter):
            continue
        if 2 * area < _FLAT * np.linalg.norm(doubled, axis=1).sum():
            continue
        around = border.beside[loop].sum(axis=0)
        normal = total / (2 * area)
        if normal @ around >= _FACING * np.linalg.norm(around):
            found.append(Cap(corners, area, normal))
    return found


def _loops(border: Border) -> list[NDArray[np.int64]]:
    """Return the closed chains of border edges, as a cap runs along them."""
    tails = border.tails.tolist()
    follower = {head: row for row, head in enumerate(border.heads.tolist())}
    loops = []
    while follower:
        first = vertex = next(iter(follower))
        loop = []
        while vertex in follower:
            loop.append(follower.pop(vertex))
            vertex = tails[loop[-1]]
        if vertex == first and len(loop) > 2:
            loops.append(np.array(loop, np.int64))
    return loops
