"""Colours of an original surface at points of its simplified mesh.

The source is the nearest point of the original that faces the same way. Simplification can move a thin sheet
(a wall, the lid of a box) past its own back side, within the error. The nearest point alone would then be on
the back and may have another colour.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface, compute_triangle_normals
from scanloom.stages.surface.surface_color import compute_surface_colors

# Maximum number of surfaces a ray passes on each side in search of one that faces the right way.
_MAX_PASSED_SURFACES = 4
# Offset at which a ray restarts behind a hit, relative to the search radius.
_RESTART_OFFSET_RATIO = 1e-4
# Distance that points are moved inwards from the edges of their triangles, in texels.
INWARD_OFFSET_TEXELS = 0.02
# Triangles whose centres are sampled to estimate the distance between both meshes.
DISTANCE_PROBES = 100_000


class ColorLookup:
    """Colour lookup of an original surface at points of its simplified mesh; thread-safe."""

    def __init__(self, original: RaycastingSurface, simplified: Mesh, texel_size: float) -> None:
        self._inward_offset_m = INWARD_OFFSET_TEXELS * texel_size
        self._original = original
        self._normals = original.normals
        self._simplified = simplified
        self._simplified_normals = compute_triangle_normals(simplified)
        self._search_radius = self._compute_search_radius()

    def __call__(self, triangles: NDArray[np.int64], weights: Floats) -> tuple[NDArray[np.floating], int]:
        """Look up the colours (k, 3) at points of the simplified mesh.

        Parameters
        ----------
        triangles : (k,) triangles of the simplified mesh.
        weights : (k, 3) barycentric weights.

        Returns
        -------
        Colours (k, 3) in levels, and the number of points whose nearest point faced away and was replaced.
        """
        found, shares, turned = self.locate(triangles, weights)
        return compute_surface_colors(self._original.mesh, found, shares), turned

    def locate(self, triangles: NDArray[np.int64], weights: Floats) -> tuple[NDArray[np.int64], Floats, int]:
        """Find the nearest points of the original that face the same way.

        Returns
        -------
        Triangles (k,) of the original, barycentric weights (k, 3), and the number of points whose nearest
        point faced away and was replaced.
        """
        corners = self._simplified.vertices[self._simplified.triangles[triangles]]
        points = np.einsum("kc,kcx->kx", weights, corners)
        points = move_inwards(points, corners.mean(axis=1), self._inward_offset_m)
        nearest = self._original.find_closest_points(points)
        found, shares = nearest.triangles, nearest.weights
        normals = self._simplified_normals[triangles]
        (facing_away,) = np.nonzero(_dot(normals, self._normals[found]) < 0)
        turned = 0
        if len(facing_away):
            replaced, others, other_shares = self._find_facing_surfaces(
                points[facing_away], normals[facing_away]
            )
            found[facing_away[replaced]], shares[facing_away[replaced]] = others, other_shares
            turned = len(replaced)
        return found, shares, turned

    def _compute_search_radius(self) -> float:
        """Return the search radius along a normal, metres.

        The radius is twice the maximum distance sampled between both meshes. A thin sheet may be displaced to
        the wrong side of itself by simplification; its right side is not much farther away than that.
        """
        step = math.ceil(len(self._simplified.triangles) / DISTANCE_PROBES)
        corners = self._simplified.vertices[self._simplified.triangles[::step]]
        return 2 * float(self._original.find_closest_points(corners.mean(axis=1)).distances.max())

    def _find_facing_surfaces(
        self, points: Floats, normals: Floats
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """Find surfaces of the original along the normals that face the same way.

        Returns
        -------
        Indices of the points for which one is within reach, and triangles and weights of the nearest one on
        either side.
        """
        best = np.full(len(points), self._search_radius)
        triangles = np.full(len(points), -1, np.int64)
        weights = np.zeros((len(points), 3))
        for side in (1, -1):
            rays, starts = np.arange(len(points)), np.zeros(len(points), np.float32)
            for _ in range(_MAX_PASSED_SURFACES):
                hits = self._original.cast_rays(points[rays], side * normals[rays], starts)
                rows = rays[hits.rays]
                near = hits.distances < best[rows]
                facing = near & (_dot(normals[rows], self._normals[hits.triangles]) > 0)
                best[rows[facing]] = hits.distances[facing]
                triangles[rows[facing]], weights[rows[facing]] = hits.triangles[facing], hits.weights[facing]
                continues = near & ~facing
                rays, starts = (
                    rows[continues],
                    hits.distances[continues] + np.float32(_RESTART_OFFSET_RATIO * self._search_radius),
                )
                if not len(rays):
                    break
        (found,) = np.nonzero(triangles >= 0)
        return found, triangles[found], weights[found]


def move_inwards(points: Floats, centers: Floats, distance: float) -> Floats:
    """Move points slightly towards the centres of their triangles.

    Charts often end at texel centres. On a sharp edge, rounding alone would choose the side a texel is
    sampled from, row by row, and gap filling would spread such stripes.
    """
    towards = centers - points
    lengths = np.sqrt(_dot(towards, towards))
    ratio = distance / np.maximum(lengths, max(distance, np.finfo(np.float64).tiny))
    return np.asarray(points + ratio[:, None] * towards)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("kx,kx->k", a, b))
