"""Irregular elements of a mesh, by defect class.

The classes follow Wang, Lu and Pan (2012, section 2.1.2). The names are the usual ones where the paper swaps
them: a cap has an angle near 180°, a needle has an angle near 0° and none near 180°. Borders, duplicate
triangles and intersecting triangles are added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._kernels import find_intersecting_triangles
from scanloom.stages.progress import Progress
from scanloom.stages.surface.cross_products import compute_area_vectors, compute_lengths, cross_rows
from scanloom.stages.surface.edges import Edges, Ids, build_edges, label_fans, pair_halfedges
from scanloom.stages.surface.mesh import Triangles, Vertices
from scanloom.stages.surface.topology import (
    find_pinched_vertices,
    has_repeated_vertex,
    is_degenerate,
    is_duplicate,
    is_inconsistent,
)

# Value of the kernel for a triangle that intersects no other.
NO_INTERSECTION = np.uint32(2**32 - 1)


@dataclass(frozen=True, kw_only=True)
class AngleLimits:
    """Angle thresholds of the defect classes, in degrees.

    Attributes
    ----------
    corner_deg : corner angles of a triangle below this, or above 180 − this, are irregular.
    fold_deg : neighbours are folded if the angle between their normals is above 180 − this.
    spike_deg : an inner vertex is a spike if its corner angles sum to less than this.
    """

    corner_deg: float
    fold_deg: float
    spike_deg: float


@dataclass(frozen=True, eq=False)
class _PreparedMesh:
    """Mesh without duplicate vertices, and its edges.

    `proper_triangles` are the triangles with three distinct vertices; `edges` are edges of these triangles.
    """

    vertices: Vertices
    triangles: Triangles
    proper_triangles: Ids
    edges: Edges

    @property
    def corners(self) -> Triangles:
        """Vertices (p, 3) of the triangles with three distinct vertices."""
        return self.triangles[self.proper_triangles]


def find_irregular(
    vertices: Vertices, triangles: Triangles, limits: AngleLimits, threads: int, progress: Progress
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
    places = find_local_irregular(vertices, triangles, limits)
    other = find_intersecting_triangles(vertices, triangles, wanted_threads=threads, progress=progress)
    return places | {"intersecting_triangles": np.flatnonzero(other != NO_INTERSECTION)}


def find_local_irregular(vertices: Vertices, triangles: Triangles, limits: AngleLimits) -> dict[str, Ids]:
    """Find the irregular elements of all classes except intersecting triangles.

    Each of these classes depends only on the triangles around an element. The result has the form of
    `find_irregular`.
    """
    (proper,) = np.nonzero(~has_repeated_vertex(triangles))
    surface = _PreparedMesh(vertices, triangles, proper, build_edges(triangles[proper], len(vertices)))
    edges = surface.edges
    singular = find_pinched_vertices(
        surface.corners, label_fans(surface.corners, *pair_halfedges(edges, edges.triangle_count > 1))
    )
    degenerate = is_degenerate(vertices, triangles)
    angles = compute_corner_angles(vertices, triangles)
    is_cap = ~degenerate & (angles.max(axis=1, initial=0) > 180 - limits.corner_deg)
    is_needle = ~degenerate & ~is_cap & (angles.min(axis=1, initial=180) < limits.corner_deg)
    return {
        "border_edges": edges.ends[edges.triangle_count == 1],
        "nonmanifold_edges": edges.ends[edges.triangle_count > 2],
        "inconsistent_edges": edges.ends[is_inconsistent(edges)],
        "singular_vertices": singular,
        "focal_vertices": _find_focal_vertices(surface),
        "singular_border_triangles": _find_lone_triangles(surface, singular),
        "degenerate_triangles": np.flatnonzero(degenerate),
        "duplicate_triangles": proper[is_duplicate(edges)],
        "caps": np.flatnonzero(is_cap),
        "needles": np.flatnonzero(is_needle),
        "sharp_edges": _find_folded_edges(surface, degenerate, limits.fold_deg),
        "spikes": _find_spikes(surface, singular, angles, limits.spike_deg),
    }


def compute_corner_angles(vertices: Vertices, triangles: Triangles | Ids) -> NDArray[np.float64]:
    """Compute the corner angles (m, 3) of triangles, in degrees."""
    places = vertices[triangles]
    found = np.empty(triangles.shape)
    for k in range(3):
        one, other = (places[:, (k + i) % 3] - places[:, k] for i in (1, 2))
        across = compute_lengths(cross_rows(one, other))
        found[:, k] = np.degrees(np.arctan2(across, np.einsum("ij,ij->i", one, other)))
    return found


def _find_focal_vertices(surface: _PreparedMesh) -> Ids:
    """Find the vertices at which more than two border edges end."""
    border = surface.edges.ends[surface.edges.triangle_count == 1]
    return np.flatnonzero(np.bincount(border.reshape(-1), minlength=len(surface.vertices)) > 2)


def _find_lone_triangles(surface: _PreparedMesh, singular: Ids) -> Ids:
    """Find triangles that share no edge at a singular vertex.

    They are recognised by the vertex having twice as many neighbours as triangles.
    """
    count = len(surface.vertices)
    triangles_at = np.bincount(surface.corners.reshape(-1), minlength=count)
    neighbours_at = np.bincount(surface.edges.ends.reshape(-1), minlength=count)
    is_alone = np.zeros(count, bool)
    is_alone[singular] = 2 * triangles_at[singular] == neighbours_at[singular]
    return np.asarray(surface.proper_triangles[is_alone[surface.corners].any(axis=1)])


def _find_folded_edges(surface: _PreparedMesh, degenerate: NDArray[np.bool_], fold_deg: float) -> Ids:
    """Find the edges (k, 2) whose triangles are folded onto each other."""
    edges = surface.edges
    (chosen,) = np.nonzero(edges.triangle_count == 2)
    edge_triangles = surface.proper_triangles[
        edges.halfedges[edges.start[chosen][:, None] + np.arange(2)] // 3
    ]
    chosen, edge_triangles = (
        rows[~degenerate[edge_triangles].any(axis=1)] for rows in (chosen, edge_triangles)
    )
    normals = compute_area_vectors(surface.vertices[surface.triangles])
    one, other = normals[edge_triangles[:, 0]], normals[edge_triangles[:, 1]]
    # For inconsistently oriented neighbours, one normal is reversed.
    sign = np.where(is_inconsistent(edges)[chosen], -1.0, 1.0)
    across = compute_lengths(cross_rows(one, other))
    angle = np.arctan2(across, sign * np.einsum("ij,ij->i", one, other))
    return np.asarray(edges.ends[chosen[np.degrees(angle) > 180 - fold_deg]])


def _find_spikes(surface: _PreparedMesh, singular: Ids, angles: NDArray[np.float64], spike_deg: float) -> Ids:
    """Find inner vertices whose corner angles sum to less than `spike_deg`."""
    count = len(surface.vertices)
    corners = surface.corners.reshape(-1)
    around = np.bincount(corners, angles[surface.proper_triangles].reshape(-1), minlength=count)
    is_spike = (around < spike_deg) & (np.bincount(corners, minlength=count) > 0)
    is_spike[surface.edges.ends[surface.edges.triangle_count != 2]] = False
    is_spike[singular] = False
    return np.flatnonzero(is_spike)
