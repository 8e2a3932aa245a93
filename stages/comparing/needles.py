"""Needles, far longer than high, which searches in single precision overlook: found all the same.

Open3D's closest point is off by up to the height of a needle, and machined parts are full of them. Cut across
into pieces that are about as long as high they are found like any other triangle; the distance is then that
of the needle itself, in double precision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, Located, Surface, closest_weights

# Height over longest side of what a search in single precision may overlook; below the lesser one a triangle
# is as good as its longest side.
_HIGHEST, _LOWEST = 0.02, 1e-4
# The same of a piece, but for those at the tips, which are short.
_PIECE = 0.1
# Share of the box's diagonal that distances in single precision are not off by.
_ROUNDED = 1e-5
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
        longest, most, area2 = surface.slimness
        (self._needles,) = np.nonzero((area2 > _LOWEST * most) & (area2 <= _HIGHEST * most))
        self._corners = mesh.vertices[mesh.triangles[self._needles]]
        self._pieces: Surface | None = None
        if len(self._needles):
            first = longest[self._needles]
            turned = self._corners[np.arange(len(first))[:, None], (first[:, None] + np.arange(3)) % 3]
            pieces, self._source = _cut(turned, area2[self._needles] / most[self._needles])
            rows = np.arange(3 * len(pieces), dtype=np.int32).reshape(-1, 3)
            self._pieces = Surface(Mesh(pieces.reshape(-1, 3), rows), box)
            # What single precision may be off by, in the place and along the height of a piece.
            highest = (area2[self._needles] / np.sqrt(most[self._needles])).max()
            self._slack = _ROUNDED * float(np.linalg.norm(box[1] - box[0])) + float(highest)

    def closest(self, points: Floats) -> Located:
        """Return the surface point nearest to each of `points`, (k, 3) float64 in metres."""
        found = self._surface.closest(points)
        if self._pieces is None or len(points) == 0:
            return found
        pieces, about = self._pieces.nearest(points)
        # Few points are so near to a needle that it can be nearer than what was found.
        (close,) = np.nonzero(about < found.distances + self._slack)
        needles = self._source[pieces[close]]
        corners = self._corners[needles]
        weights = closest_weights(points[close], corners)
        distances = np.linalg.norm(points[close] - np.einsum("kc,kcx->kx", weights, corners), axis=1)
        is_nearer = distances < found.distances[close]
        nearer = close[is_nearer]
        found.triangles[nearer] = self._needles[needles[is_nearer]]
        found.weights[nearer] = weights[is_nearer]
        found.distances[nearer] = distances[is_nearer]
        return found


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
