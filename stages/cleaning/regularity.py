"""Where a mesh is not regular: what the next program may stumble over, class by class.

The classes are those of Wang, Lu and Pan (2012, section 2.1.2), with the field's names where theirs are
exchanged (a cap has one angle near 180°, a needle none and one near 0°), and three more: borders,
duplicates and triangles that meet where the mesh does not say so.
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

# What the kernel says of a triangle that meets none.
NO_OTHER = np.uint32(2**32 - 1)


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What counts as irregular; all in degrees.

    Attributes
    ----------
    corner : an angle of a triangle is too small below this, and too large above 180 − this.
    fold : two triangles are folded onto each other where their normals are apart by more than 180 − this.
    spike : a vertex inside the surface is a spike if the angles around it have less than this in sum.
    """

    corner: float
    fold: float
    spike: float


@dataclass(frozen=True, eq=False)
class _Surface:
    """A mesh without copies of vertices, its triangles that repeat no vertex, and their edges."""

    vertices: Vertices
    triangles: Triangles
    proper: Ids
    edges: Edges

    @property
    def corners(self) -> Triangles:
        """The vertices of the proper triangles, (p, 3)."""
        return self.triangles[self.proper]


def irregular(
    vertices: Vertices, triangles: Triangles, limits: Limits, threads: int, progress: Progress
) -> dict[str, Ids]:
    """Return the places of each class.

    Parameters
    ----------
    vertices, triangles : (n, 3) float64 m and (m, 3) int32; vertices of equal position have one number.
    threads : 0 for one a core.

    Returns
    -------
    dict : vertices (k,), edges (k, 2) by their vertices, the smaller first, or triangles (k,); ascending.
    """
    places = irregular_neighbourhoods(vertices, triangles, limits)
    other = intersecting_triangles(vertices, triangles, wanted_threads=threads, progress=progress)
    return places | {"intersecting_triangles": np.flatnonzero(other != NO_OTHER)}


def irregular_neighbourhoods(vertices: Vertices, triangles: Triangles, limits: Limits) -> dict[str, Ids]:
    """Return, as `irregular`, the places of all classes but that of triangles that intersect.

    Each is seen from the triangles around it alone.
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
    """Return the angles (m, 3) at the corners of triangles, degrees."""
    places = vertices[triangles]
    found = np.empty(triangles.shape)
    for k in range(3):
        one, other = (places[:, (k + i) % 3] - places[:, k] for i in (1, 2))
        across = np.linalg.norm(np.cross(one, other), axis=1)
        found[:, k] = np.degrees(np.arctan2(across, np.einsum("ij,ij->i", one, other)))
    return found


def _focal(surface: _Surface) -> Ids:
    """Return the vertices at which more than two edges of one triangle end."""
    border = surface.edges.ends[surface.edges.count == 1]
    return np.flatnonzero(np.bincount(border.reshape(-1), minlength=len(surface.vertices)) > 2)


def _alone_at(surface: _Surface, singular: Ids) -> Ids:
    """Return the triangles at singular vertices with twice as many neighbours: each is alone there."""
    count = len(surface.vertices)
    triangles_at = np.bincount(surface.corners.reshape(-1), minlength=count)
    neighbours_at = np.bincount(surface.edges.ends.reshape(-1), minlength=count)
    is_alone = np.zeros(count, bool)
    is_alone[singular] = 2 * triangles_at[singular] == neighbours_at[singular]
    return np.asarray(surface.proper[is_alone[surface.corners].any(axis=1)])


def _folded(surface: _Surface, degenerate: NDArray[np.bool_], fold: float) -> Ids:
    """Return the edges whose two triangles lie nearly on each other."""
    edges = surface.edges
    (chosen,) = np.nonzero(edges.count == 2)
    both = surface.proper[edges.halfedges[edges.start[chosen][:, None] + np.arange(2)] // 3]
    chosen, both = (rows[~degenerate[both].any(axis=1)] for rows in (chosen, both))
    corners = surface.vertices[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    one, other = normals[both[:, 0]], normals[both[:, 1]]
    # Of two that run against each other one looks the wrong way.
    sign = np.where(inconsistent(edges)[chosen], -1.0, 1.0)
    apart = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), sign * np.einsum("ij,ij->i", one, other))
    return np.asarray(edges.ends[chosen[np.degrees(apart) > 180 - fold]])


def _spikes(surface: _Surface, singular: Ids, angles: NDArray[np.float64], least: float) -> Ids:
    """Return the vertices inside the surface around which there is little of it."""
    count = len(surface.vertices)
    corners = surface.corners.reshape(-1)
    around = np.bincount(corners, angles[surface.proper].reshape(-1), minlength=count)
    is_spike = (around < least) & (np.bincount(corners, minlength=count) > 0)
    is_spike[surface.edges.ends[surface.edges.count != 2]] = False
    is_spike[singular] = False
    return np.flatnonzero(is_spike)
