"""Irregular elements of a mesh, by defect class.

The classes follow Wang, Lu and Pan (2012, section 2.1.2). The names are the usual ones where the paper swaps
them: a cap has an angle near 180°, a needle has an angle near 0° and none near 180°. Borders, duplicate
triangles and intersecting triangles are added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._kernels import intersecting_triangles
from scanloom.stages.progress import Progress
from scanloom.stages.surface.edges import Edges, Ids, edges_of, fans, neighbours
from scanloom.stages.surface.mesh import Triangles, Vertices
from scanloom.stages.surface.topology import (
    inconsistent,
    is_degenerate,
    is_duplicate,
    pinched,
    repeats_vertex,
)

# Value of the kernel for a triangle that intersects no other.
NO_OTHER = np.uint32(2**32 - 1)


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Angle thresholds of the defect classes, in degrees.

    Attributes
    ----------
    corner : corner angles of a triangle below this, or above 180 − this, are irregular.
    fold : neighbours are folded if the angle between their normals is above 180 − this.
    spike : an inner vertex is a spike if its corner angles sum to less than this.
    """

    corner: float
    fold: float
    spike: float


@dataclass(frozen=True, eq=False)
class _Surface:
    """Mesh without duplicate vertices, and its edges.

    `proper` are the triangles with three distinct vertices; `edges` are edges of these triangles.
    """

    vertices: Vertices
    triangles: Triangles
    proper: Ids
    edges: Edges

    @property
    def corners(self) -> Triangles:
        """Vertices (p, 3) of the triangles with three distinct vertices."""
        return self.triangles[self.proper]


def irregular(
    vertices: Vertices, triangles: Triangles, limits: Limits, threads: int, progress: Progress
) -> dict[str, Ids]:
    """Find the irregular elements of each class.

    Parameters
    ----------
    vertices, triangles : (n, 3) float64, metres, and (m, 3) int32, without duplicate vertices.
    limits : angle thresholds.
    threads : 0 for one per core.
    progress : called with (triangles tested for intersections, all triangles).

    Returns
    -------
    dict : per class, vertices (k,), edges (k, 2) with the smaller vertex index first, or triangles (k,),
        ascending.
    """
    places = irregular_neighbourhoods(vertices, triangles, limits)
    other = intersecting_triangles(vertices, triangles, wanted_threads=threads, progress=progress)
    return places | {"intersecting_triangles": np.flatnonzero(other != NO_OTHER)}


def irregular_neighbourhoods(vertices: Vertices, triangles: Triangles, limits: Limits) -> dict[str, Ids]:
    """Find the irregular elements of all classes except intersecting triangles.

    Each of these classes depends only on the triangles around an element. The result has the form of
    `irregular`.
    """
    (proper,) = np.nonzero(~repeats_vertex(triangles))
    surface = _Surface(vertices, triangles, proper, edges_of(triangles[proper], len(vertices)))
    edges = surface.edges
    singular = pinched(surface.corners, fans(surface.corners, *neighbours(edges, edges.count > 1)))
    degenerate = is_degenerate(vertices, triangles)
    angles = corner_angles(vertices, triangles)
    is_cap = ~degenerate & (angles.max(axis=1, initial=0) > 180 - limits.corner)
    is_needle = ~degenerate & ~is_cap & (angles.min(axis=1, initial=180) < limits.corner)
    return {
        "border_edges": edges.ends[edges.count == 1],
        "nonmanifold_edges": edges.ends[edges.count > 2],
        "inconsistent_edges": edges.ends[inconsistent(edges)],
        "singular_vertices": singular,
        "focal_vertices": _focal(surface),
        "singular_border_triangles": _alone_at(surface, singular),
        "degenerate_triangles": np.flatnonzero(degenerate),
        "duplicate_triangles": proper[is_duplicate(edges)],
        "caps": np.flatnonzero(is_cap),
        "needles": np.flatnonzero(is_needle),
        "sharp_edges": _folded(surface, degenerate, limits.fold),
        "spikes": _spikes(surface, singular, angles, limits.spike),
    }


def corner_angles(vertices: Vertices, triangles: Triangles | Ids) -> NDArray[np.float64]:
    """Compute the corner angles (m, 3) of triangles, in degrees."""
    places = vertices[triangles]
    found = np.empty(triangles.shape)
    for k in range(3):
        one, other = (places[:, (k + i) % 3] - places[:, k] for i in (1, 2))
        across = np.linalg.norm(np.cross(one, other), axis=1)
        found[:, k] = np.degrees(np.arctan2(across, np.einsum("ij,ij->i", one, other)))
    return found


def _focal(surface: _Surface) -> Ids:
    """Find the vertices at which more than two border edges end."""
    border = surface.edges.ends[surface.edges.count == 1]
    return np.flatnonzero(np.bincount(border.reshape(-1), minlength=len(surface.vertices)) > 2)


def _alone_at(surface: _Surface, singular: Ids) -> Ids:
    """Find triangles that share no edge at a singular vertex.

    They are recognised by the vertex having twice as many neighbours as triangles.
    """
    count = len(surface.vertices)
    triangles_at = np.bincount(surface.corners.reshape(-1), minlength=count)
    neighbours_at = np.bincount(surface.edges.ends.reshape(-1), minlength=count)
    is_alone = np.zeros(count, bool)
    is_alone[singular] = 2 * triangles_at[singular] == neighbours_at[singular]
    return np.asarray(surface.proper[is_alone[surface.corners].any(axis=1)])


def _folded(surface: _Surface, degenerate: NDArray[np.bool_], fold: float) -> Ids:
    """Find the edges (k, 2) whose triangles are folded onto each other."""
    edges = surface.edges
    (chosen,) = np.nonzero(edges.count == 2)
    both = surface.proper[edges.halfedges[edges.start[chosen][:, None] + np.arange(2)] // 3]
    chosen, both = (rows[~degenerate[both].any(axis=1)] for rows in (chosen, both))
    corners = surface.vertices[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    one, other = normals[both[:, 0]], normals[both[:, 1]]
    # For inconsistently oriented neighbours, one normal is reversed.
    sign = np.where(inconsistent(edges)[chosen], -1.0, 1.0)
    apart = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), sign * np.einsum("ij,ij->i", one, other))
    return np.asarray(edges.ends[chosen[np.degrees(apart) > 180 - fold]])


def _spikes(surface: _Surface, singular: Ids, angles: NDArray[np.float64], least: float) -> Ids:
    """Find inner vertices whose corner angles sum to less than `least`."""
    count = len(surface.vertices)
    corners = surface.corners.reshape(-1)
    around = np.bincount(corners, angles[surface.proper].reshape(-1), minlength=count)
    is_spike = (around < least) & (np.bincount(corners, minlength=count) > 0)
    is_spike[surface.edges.ends[surface.edges.count != 2]] = False
    is_spike[singular] = False
    return np.flatnonzero(is_spike)
