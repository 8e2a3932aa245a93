"""Irregular elements of a mesh, by defect class.

The classes follow Wang, Lu and Pan (2012, section 2.1.2). The names are the usual ones where the paper swaps
them: a cap has an angle near 180°, a needle has an angle near 0° and none near 180°. Borders, duplicate
triangles and intersecting triangles are added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._kernels import find_intersecting_triangles, find_irregular_elements
from scanloom.stages.progress import Progress
from scanloom.stages.surface.cross_products import compute_lengths, cross_rows
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Triangles, Vertices

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


def find_irregular(
    vertices: Vertices, triangles: Triangles, limits: AngleLimits, threads: int, progress: Progress
) -> tuple[dict[str, Ids], dict[str, int]]:
    """Find the irregular elements of each class, and count the edges and components.

    Parameters
    ----------
    vertices, triangles : (n, 3) float64, metres, and (m, 3) int32, without duplicate vertices.
    limits : angle thresholds.
    threads : 0 for one per core.
    progress : called with (triangles tested for intersections, all triangles).

    Returns
    -------
    places : per class, vertices (k,), edges (k, 2) with the smaller vertex index first, or triangles (k,),
        ascending.
    counts : counts for `scanloom.stages.surface.topology.make_topology`.
    """
    places, counts = _find_elements(vertices, triangles, limits, threads)
    other = find_intersecting_triangles(vertices, triangles, wanted_threads=threads, progress=progress)
    return places | {"intersecting_triangles": np.flatnonzero(other != NO_INTERSECTION)}, counts


def find_local_irregular(vertices: Vertices, triangles: Triangles, limits: AngleLimits) -> dict[str, Ids]:
    """Find the irregular elements of all classes except intersecting triangles.

    Each of these classes depends only on the triangles around an element. The result has the form of
    `find_irregular`.
    """
    return _find_elements(vertices, triangles, limits, 1)[0]


def _find_elements(
    vertices: Vertices, triangles: Triangles, limits: AngleLimits, threads: int
) -> tuple[dict[str, Ids], dict[str, int]]:
    places, counts = find_irregular_elements(
        vertices,
        triangles,
        corner_deg=limits.corner_deg,
        fold_deg=limits.fold_deg,
        spike_deg=limits.spike_deg,
        wanted_threads=threads,
    )
    return dict(places), counts


def compute_corner_angles(vertices: Vertices, triangles: Triangles | Ids) -> NDArray[np.float64]:
    """Compute the corner angles (m, 3) of triangles, in degrees."""
    places = vertices[triangles]
    found = np.empty(triangles.shape)
    for k in range(3):
        one, other = (places[:, (k + i) % 3] - places[:, k] for i in (1, 2))
        across = compute_lengths(cross_rows(one, other))
        found[:, k] = np.degrees(np.arctan2(across, np.einsum("ij,ij->i", one, other)))
    return found
