"""Closest-point search that is exact for needle triangles.

For needles (triangles far longer than high), Open3D's closest point in single precision has an error of up to
the height of the needle. CAD parts contain many needles. Needles are therefore cut across into pieces of
moderate aspect ratio, which the search finds reliably. The distance is then computed on the original needle
in double precision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import (
    ClosestPoints,
    Floats,
    RaycastingSurface,
    compute_closest_weights,
)

# Ratios of height to longest side that single precision handles badly. Below the minimum, the longest side
# represents the triangle.
_MAX_NEEDLE_RATIO, _MIN_NEEDLE_RATIO = 0.02, 1e-4
# Target ratio of height to longest side of the pieces, except for the short pieces at the tips.
_PIECE_RATIO = 0.1
# Error bound of distances in single precision, as ratio of the box diagonal.
_ROUNDING_RATIO = 1e-5
# Approximate limit on the number of pieces of all needles together; beyond it, pieces get longer.
_MAX_PIECES = 1 << 20


class NeedleSafeSurface:
    """Surface with closest-point queries that are exact for needle triangles, too.

    Parameters
    ----------
    surface : search structure that handles all other triangles.
    box : (2, 3) minimum and maximum corner of all geometry involved in queries.
    """

    def __init__(self, surface: RaycastingSurface, box: Floats) -> None:
        self.mesh = mesh = surface.mesh
        self._surface = surface
        longest, longest_squared, area2 = surface.slimness
        (self._needle_triangles,) = np.nonzero(
            (area2 > _MIN_NEEDLE_RATIO * longest_squared) & (area2 <= _MAX_NEEDLE_RATIO * longest_squared)
        )
        self._needle_corners = mesh.vertices[mesh.triangles[self._needle_triangles]]
        self._piece_surface: RaycastingSurface | None = None
        if len(self._needle_triangles):
            first = longest[self._needle_triangles]
            turned = self._needle_corners[np.arange(len(first))[:, None], (first[:, None] + np.arange(3)) % 3]
            pieces, self._piece_needles = _cut_needles(
                turned, area2[self._needle_triangles] / longest_squared[self._needle_triangles]
            )
            rows = np.arange(3 * len(pieces), dtype=np.int32).reshape(-1, 3)
            self._piece_surface = RaycastingSurface(Mesh(pieces.reshape(-1, 3), rows), box)
            # Error bound of the search: single-precision rounding plus the height of the highest needle.
            highest = (area2[self._needle_triangles] / np.sqrt(longest_squared[self._needle_triangles])).max()
            self._search_error = _ROUNDING_RATIO * float(np.linalg.norm(box[1] - box[0])) + float(highest)

    def find_closest_points(self, points: Floats) -> ClosestPoints:
        """Return the surface point nearest to each of `points`, (k, 3) float64 in metres."""
        found = self._surface.find_closest_points(points)
        if self._piece_surface is None or len(points) == 0:
            return found
        pieces, about = self._piece_surface.find_nearest_triangles(points)
        # Only few points are close enough to a needle for it to be the nearest triangle.
        (near_rows,) = np.nonzero(about < found.distances + self._search_error)
        needles = self._piece_needles[pieces[near_rows]]
        corners = self._needle_corners[needles]
        weights = compute_closest_weights(points[near_rows], corners)
        distances = np.linalg.norm(points[near_rows] - np.einsum("kc,kcx->kx", weights, corners), axis=1)
        is_nearer = distances < found.distances[near_rows]
        nearer = near_rows[is_nearer]
        found.triangles[nearer] = self._needle_triangles[needles[is_nearer]]
        found.weights[nearer] = weights[is_nearer]
        found.distances[nearer] = distances[is_nearer]
        return found


def _cut_needles(corners: Floats, flatness: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Cut needles crosswise into pieces, from both tips to the altitude.

    Parameters
    ----------
    corners : (n, 3, 3) corners of the needles; the longest side is first.
    flatness : (n,) ratio of height to longest side.

    Returns
    -------
    pieces : (p, 3, 3) corners.
    source : (p,) index of the needle that each piece belongs to.
    """
    a, b, c = corners.transpose(1, 0, 2)
    along = b - a
    foot = np.einsum("kx,kx->k", c - a, along) / np.einsum("kx,kx->k", along, along)
    below = a + foot.clip(0, 1)[:, None] * along
    halves = np.stack([a, below, c, b, c, below], axis=1).reshape(-1, 3, 3)
    wanted = _PIECE_RATIO / flatness
    # Each strip has two pieces, and each needle two halves.
    share = min(1.0, _MAX_PIECES / (4 * float(wanted.sum())))
    count = np.repeat(np.ceil(share * wanted).astype(np.int64), 2)
    half = np.repeat(np.arange(len(halves)), count)
    start = np.arange(len(half)) - np.repeat(np.cumsum(count) - count, count)
    near, far = (((start + end) / count[half])[:, None] for end in (0, 1))
    tip, low, high = halves[half].transpose(1, 0, 2)
    first, last, far_first, far_last = (
        tip + share * (end - tip) for share in (near, far) for end in (low, high)
    )
    pieces = np.stack([first, far_first, far_last, first, far_last, last], axis=1).reshape(-1, 3, 3)
    return pieces, np.repeat(half // 2, 2)
