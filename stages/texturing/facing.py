"""Colours of an original surface at points of its simplified mesh.

The source is the nearest point of the original that faces the same way. Simplification can move a thin sheet
(a wall, the lid of a box) past its own back side, within the error. The nearest point alone would then be on
the back and may have another colour.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.color import color_at
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, Surface, unit_normals

# Maximum number of surfaces a ray passes on each side in search of one that faces the right way.
_PASSED = 4
# Offset at which a ray restarts behind a hit, relative to the search radius.
_STEP = 1e-4
# Distance that points are moved inwards from the edges of their triangles, in texels.
INWARDS = 0.02
# Triangles whose centres are sampled to estimate the distance between both meshes.
PROBES = 100_000


class FacingColors:
    """Colour lookup of an original surface at points of its simplified mesh; thread-safe."""

    def __init__(self, original: Surface, light: Mesh, texel_size: float) -> None:
        self._inwards = INWARDS * texel_size
        self._original = original
        self._normals = original.normals
        self._light = light
        self._light_normals = unit_normals(light)
        self._reach = self._farthest()

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
        return color_at(self._original.mesh, found, shares), turned

    def locate(self, triangles: NDArray[np.int64], weights: Floats) -> tuple[NDArray[np.int64], Floats, int]:
        """Find the nearest points of the original that face the same way.

        Returns
        -------
        Triangles (k,) of the original, barycentric weights (k, 3), and the number of points whose nearest
        point faced away and was replaced.
        """
        corners = self._light.vertices[self._light.triangles[triangles]]
        points = np.einsum("kc,kcx->kx", weights, corners)
        points = move_inwards(points, corners.mean(axis=1), self._inwards)
        nearest = self._original.closest(points)
        found, shares = nearest.triangles, nearest.weights
        normals = self._light_normals[triangles]
        (away,) = np.nonzero(_dot(normals, self._normals[found]) < 0)
        turned = 0
        if len(away):
            chosen, others, other_shares = self._facing(points[away], normals[away])
            found[away[chosen]], shares[away[chosen]] = others, other_shares
            turned = len(chosen)
        return found, shares, turned

    def _farthest(self) -> float:
        """Return the search radius along a normal, metres.

        The radius is twice the maximum distance sampled between both meshes. A thin sheet may be displaced to
        the wrong side of itself by simplification; its right side is not much farther away than that.
        """
        step = math.ceil(len(self._light.triangles) / PROBES)
        corners = self._light.vertices[self._light.triangles[::step]]
        return 2 * float(self._original.closest(corners.mean(axis=1)).distances.max())

    def _facing(self, points: Floats, normals: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """Find surfaces of the original along the normals that face the same way.

        Returns
        -------
        Indices of the points for which one is within reach, and triangles and weights of the nearest one on
        either side.
        """
        best = np.full(len(points), self._reach)
        triangles = np.full(len(points), -1, np.int64)
        weights = np.zeros((len(points), 3))
        for side in (1, -1):
            rays, starts = np.arange(len(points)), np.zeros(len(points), np.float32)
            for _ in range(_PASSED):
                hits = self._original.cast(points[rays], side * normals[rays], starts)
                rows = rays[hits.rays]
                near = hits.distances < best[rows]
                facing = near & (_dot(normals[rows], self._normals[hits.triangles]) > 0)
                best[rows[facing]] = hits.distances[facing]
                triangles[rows[facing]], weights[rows[facing]] = hits.triangles[facing], hits.weights[facing]
                on = near & ~facing
                rays, starts = rows[on], hits.distances[on] + np.float32(_STEP * self._reach)
                if not len(rays):
                    break
        (found,) = np.nonzero(triangles >= 0)
        return found, triangles[found], weights[found]


def move_inwards(points: Floats, middles: Floats, distance: float) -> Floats:
    """Move points slightly towards the centres of their triangles.

    Charts often end at texel centres. On a sharp edge, rounding alone would choose the side a texel is
    sampled from, row by row, and gap filling would spread such stripes.
    """
    towards = middles - points
    lengths = np.sqrt(_dot(towards, towards))
    share = distance / np.maximum(lengths, max(distance, np.finfo(np.float64).tiny))
    return np.asarray(points + share[:, None] * towards)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("kx,kx->k", a, b))
