"""The colours of an original at places on a light mesh: where it is nearest and faces the same way.

A thin sheet with other colours on its back, such as a wall or the lid of a box, comes out of simplification
up to the error of that on the wrong side of itself; the nearest point alone would then show the back.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.color import color_at
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, Surface, unit_normals

# Surfaces that are passed on the way to one that faces the right way, to each side.
_PASSED = 4
# A ray goes on behind what it met this share of its reach later.
_STEP = 1e-4
# Of a texel, that places are moved away from the edges of their triangles.
INWARDS = 0.02
# Triangles whose middles tell how far the light mesh is from the original.
PROBES = 100_000


class FacingColors:
    """The colours of an original at places on a light mesh; several threads may ask at once."""

    def __init__(self, original: Surface, light: Mesh, texel_size: float) -> None:
        self._inwards = INWARDS * texel_size
        self._original = original
        self._normals = original.normals
        self._light = light
        self._light_normals = unit_normals(light)
        self._reach = self._farthest()

    def __call__(self, triangles: NDArray[np.int64], weights: Floats) -> tuple[NDArray[np.floating], int]:
        """Return the colours (k, 3) at points of the light mesh.

        Beside them, at how many points the nearest one of the original faced away and another did not.
        """
        found, shares, turned = self.locate(triangles, weights)
        return color_at(self._original.mesh, found, shares), turned

    def locate(self, triangles: NDArray[np.int64], weights: Floats) -> tuple[NDArray[np.int64], Floats, int]:
        """Find the points of the original nearest to points of the simplified mesh, facing the same way.

        Returns
        -------
        Triangles (k,) of the original, barycentric weights (k, 3), and how many nearest points faced away
        while another did not.
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
        """Return how far, in metres, the original is looked for along a normal.

        Twice the largest distance found between the two: where a thin sheet has come out on the wrong side of
        itself, its right side is not much farther than that.
        """
        step = math.ceil(len(self._light.triangles) / PROBES)
        corners = self._light.vertices[self._light.triangles[::step]]
        return 2 * float(self._original.closest(corners.mean(axis=1)).distances.max())

    def _facing(self, points: Floats, normals: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """Return, for which points there is a surface within reach along the normal that faces its way.

        Returns
        -------
        The points' numbers, and the triangles and weights of the nearest such surface, to either side.
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
    """Move points a little towards the middles of their triangles.

    Charts often end at texel centres: on a sharp edge rounding alone would choose the side it is taken
    from, line by line, and what fills the gaps continues that.
    """
    towards = middles - points
    lengths = np.sqrt(_dot(towards, towards))
    share = distance / np.maximum(lengths, max(distance, np.finfo(np.float64).tiny))
    return np.asarray(points + share[:, None] * towards)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("kx,kx->k", a, b))
