"""Needles, far longer than high, which searches in single precision overlook: found all the same.

Open3D's closest point is off by up to the height of a needle, and machined parts are full of them. Cut across
into pieces that are about as long as high they are found like any other triangle; the distance is then that
of the needle itself, in double precision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.surface.mesh import Mesh
from stages.surface.raycasting import Floats, Located, Surface, closest_weights

# Height over longest side of what a search in single precision may overlook; below the lesser one a triangle
# is as good as its longest side.
_HIGHEST, _LOWEST = 0.02, 1e-4
# The same of a piece, but for those at the tips, which are short.
_PIECE = 0.1
# Pieces of all needles together, about; beyond, they are longer.
_MOST_PIECES = 1 << 20


class WithNeedles:
    """A surface whose closest points may lie on needles.

    Parameters
    ----------
    surface : that is asked for all other triangles.
    box : (2, 3) lowest and highest corner of everything that will be asked.
    """

    def __init__(self, surface: Surface, box: Floats) -> None:
        self.mesh = mesh = surface.mesh
        self._surface = surface
        corners = mesh.vertices[mesh.triangles]
        sides = np.roll(corners, -1, axis=1) - corners
        lengths2 = np.einsum("ksx,ksx->ks", sides, sides)
        area2 = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        most = lengths2.max(axis=1)
        (self._needles,) = np.nonzero((area2 > _LOWEST * most) & (area2 <= _HIGHEST * most))
        self._corners = corners[self._needles]
        self._pieces: Surface | None = None
        if len(self._needles):
            first = lengths2[self._needles].argmax(axis=1)
            turned = self._corners[np.arange(len(first))[:, None], (first[:, None] + np.arange(3)) % 3]
            pieces, self._source = _cut(turned, area2[self._needles] / most[self._needles])
            rows = np.arange(3 * len(pieces), dtype=np.int32).reshape(-1, 3)
            self._pieces = Surface(Mesh(pieces.reshape(-1, 3), rows), box)

    def closest(self, points: Floats) -> Located:
        """Return the surface point nearest to each of `points`, (k, 3) float64 in metres."""
        found = self._surface.closest(points)
        if self._pieces is None:
            return found
        needles = self._source[self._pieces.closest(points).triangles]
        corners = self._corners[needles]
        weights = closest_weights(points, corners)
        distances = np.linalg.norm(points - np.einsum("kc,kcx->kx", weights, corners), axis=1)
        is_nearer = distances < found.distances
        return Located(
            triangles=np.where(is_nearer, self._needles[needles], found.triangles),
            weights=np.where(is_nearer[:, None], weights, found.weights),
            distances=np.where(is_nearer, distances, found.distances),
        )


def _cut(corners: Floats, flatness: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Cut needles, their longest side first, across: from either tip to where they are highest.

    Returns
    -------
    pieces : (p, 3, 3) corners.
    source : (p,) the needle each is of.
    """
    a, b, c = corners.transpose(1, 0, 2)
    along = b - a
    foot = np.einsum("kx,kx->k", c - a, along) / np.einsum("kx,kx->k", along, along)
    below = a + foot.clip(0, 1)[:, None] * along
    halves = np.stack([a, below, c, b, c, below], axis=1).reshape(-1, 3, 3)
    wanted = _PIECE / flatness
    # A strip has two pieces, and a needle two halves.
    share = min(1.0, _MOST_PIECES / (4 * float(wanted.sum())))
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
