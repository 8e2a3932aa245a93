"""Sample positions of texels, on the surface and beyond the borders of charts.

A border texel is sampled beyond the border on the plane of its triangle. Bilinear interpolation at the border
then gives the right colour.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.pages import Pages, Texels

Floats = NDArray[np.float64]

# Maximum distance of a sample from its triangle, in texels on the surface; only strongly compressed charts
# reach it.
_BEYOND = 4.0
# Distance in texels up to which two corners coincide in the atlas.
_SAME = 1e-6
# Kind of a triangle's side: inside a chart, on the border of a chart, or on the boundary of the mesh.
WITHIN, BORDER, END = range(3)


def samples_under(
    mesh: Mesh, pages: Pages, texels: Texels, width: int, along: int, texel_size: float
) -> tuple[NDArray[np.int64], Floats]:
    """Compute the samples of texels, `along` × `along` in each, ordered by texel.

    Parameters
    ----------
    texels : texels of one image.
    width : width of the image, texels.
    along : samples along each side of a texel.
    texel_size : metres on the surface.

    Returns
    -------
    triangles : (k,) triangle of each sample.
    weights : (k, 3) barycentric weights with sum 1; negative beyond the triangle.
    """
    triangles = texels.triangles.astype(np.int64)
    row, column = np.divmod(texels.pixels.astype(np.int64), width)
    steps = (np.arange(along) + 0.5) / along
    # Axes: texel, sample, (x, y).
    steps = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    points = np.stack([column, row], axis=1)[:, None] + steps
    inside = texels.shares.astype(np.float64)[:, None]
    outwards = _weights(pages.corners[triangles], points) - inside
    far = np.linalg.norm(outwards @ mesh.vertices[mesh.triangles[triangles]], axis=2, keepdims=True)
    reach = _BEYOND * texel_size
    weights = inside + outwards * (reach / np.maximum(far, reach))
    return np.repeat(triangles, along**2), weights.reshape(-1, 3)


def _weights(corners: Floats, points: Floats) -> Floats:
    """Compute barycentric weights (k, s, 3) of points (k, s, 2) in triangles (k, 3, 2)."""
    a, sides = corners[:, None, 0], corners[:, None, 1:] - corners[:, None, :1]
    (ux, uy), (vx, vy) = (np.moveaxis(sides[:, :, k], -1, 0) for k in (0, 1))
    px, py = np.moveaxis(points - a, -1, 0)
    area = ux * vy - uy * vx
    # The area is 0 only by rounding; such a triangle is sampled at its centre.
    is_flat = area == 0
    area = np.where(is_flat, 1.0, area)
    v = np.where(is_flat, 1 / 3, (px * vy - py * vx) / area)
    w = np.where(is_flat, 1 / 3, (ux * py - uy * px) / area)
    return np.asarray(np.stack([1 - v - w, v, w], axis=-1))


def borders(mesh: Mesh, pages: Pages) -> NDArray[np.uint8]:
    """Classify the side opposite each corner, (m, 3) uint8: `WITHIN`, `BORDER` or `END`."""
    first, second = np.array([1, 2, 0]), np.array([2, 0, 1])
    ends = np.stack([mesh.triangles[:, first], mesh.triangles[:, second]], axis=-1).astype(np.int64)
    places = np.stack([pages.corners[:, first], pages.corners[:, second]], axis=2)
    # Orient each side from its lower vertex index, so that both adjacent triangles give the same key.
    turn = ends[..., 0] > ends[..., 1]
    ends[turn], places[turn] = ends[turn][:, ::-1], places[turn][:, ::-1]
    key = (ends[..., 0] * len(mesh.vertices) + ends[..., 1]).ravel()
    places, images = places.reshape(-1, 4), np.repeat(pages.pages, 3)
    order = np.argsort(key, kind="stable")
    a, b = order[:-1], order[1:]
    meet = key[a] == key[b]
    joined = meet & (images[a] == images[b]) & (np.abs(places[a] - places[b]).max(axis=1) < _SAME)
    kinds = np.full(len(key), END, np.uint8)
    kinds[a[meet]] = kinds[b[meet]] = BORDER
    kinds[a[joined]] = kinds[b[joined]] = WITHIN
    return kinds.reshape(-1, 3)
