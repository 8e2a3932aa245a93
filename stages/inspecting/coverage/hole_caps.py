"""Holes in a surface, and caps that would close them.

Holes are closed boundary loops. The outline of a component and the end of a scan are closed boundaries, too.
A cap over a hole has the orientation of the surrounding triangles; a cap over an outline has the opposite
one. A loop that winds through the whole scan has no meaningful cap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.boundary import SurfaceBoundary
from scanloom.stages.inspecting.coverage.depth_view import Floats

# Minimum cosine between a cap and the surrounding triangles; at the open end of a tube it is 0.
_MIN_FACING_COSINE = -0.5
# Minimum ratio of a cap's vector area to its total area. Below it, the cap has no defined side.
_MIN_FLAT_RATIO = 0.6
# Minimum width of a hole in mesh edges; narrower ones are cracks.
_MIN_WIDTH_EDGES = 3.0


@dataclass(frozen=True, eq=False)
class HoleCap:
    """Triangle fan that would close a hole.

    Attributes
    ----------
    corners : (k, 3, 3) float64, from the rim to its centroid, metres, in mesh coordinates.
    area : m².
    normal : (3,) unit, oriented like the surrounding surface.
    """

    corners: Floats
    area: float
    normal: Floats


def build_caps(border: SurfaceBoundary, median_edge: float, min_area: float) -> list[HoleCap]:
    """Build caps for the holes of an oriented manifold.

    Parameters
    ----------
    border : boundary of the whole mesh.
    median_edge : median edge length of the mesh, metres.
    min_area : m²; smaller holes are dropped.
    """
    found = []
    for loop in _chain_loops(border):
        rim = border.ends[loop]
        after = np.roll(rim, -1, axis=0)
        corners = np.stack([rim, after, np.broadcast_to(rim.mean(axis=0), rim.shape)], axis=1)
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        total = doubled.sum(axis=0)
        area = float(np.linalg.norm(total)) / 2
        perimeter = float(np.linalg.norm(after - rim, axis=1).sum())
        if area < max(min_area, 0.5 * _MIN_WIDTH_EDGES * median_edge * perimeter):
            continue
        if 2 * area < _MIN_FLAT_RATIO * np.linalg.norm(doubled, axis=1).sum():
            continue
        around = border.triangle_normals[loop].sum(axis=0)
        normal = total / (2 * area)
        if normal @ around >= _MIN_FACING_COSINE * np.linalg.norm(around):
            found.append(HoleCap(corners, area, normal))
    return found


def _chain_loops(border: SurfaceBoundary) -> list[NDArray[np.int64]]:
    """Chain boundary edges into closed loops, in a cap's winding direction."""
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
