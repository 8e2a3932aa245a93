"""Sample positions of texels, on the surface and beyond the borders of charts.

A border texel is sampled beyond the border on the plane of its triangle. Bilinear interpolation at the border
then gives the right colour.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.atlas_layout import AtlasLayout, PageTexels

Floats = NDArray[np.float64]

# Maximum distance of a sample from its triangle, in texels on the surface; only strongly compressed charts
# reach it.
_MAX_OVERSHOOT_TEXELS = 4.0
# Distance in texels up to which two corners coincide in the atlas.
_COINCIDENCE_TEXELS = 1e-6
# Kind of a triangle's side: inside a chart, on the border of a chart, or on the boundary of the mesh.
INSIDE_CHART, CHART_BORDER, MESH_BOUNDARY = range(3)


def sample_texels(
    mesh: Mesh, pages: AtlasLayout, texels: PageTexels, width: int, samples_per_side: int, texel_size: float
) -> tuple[NDArray[np.int64], Floats]:
    """Compute the samples of texels, `samples_per_side` × `samples_per_side` in each, ordered by texel.

    Parameters
    ----------
    texels : texels of one image.
    width : width of the image, texels.
    samples_per_side : samples along each side of a texel.
    texel_size : metres on the surface.

    Returns
    -------
    triangles : (k,) triangle of each sample.
    weights : (k, 3) barycentric weights with sum 1; negative beyond the triangle.
    """
    triangles = texels.triangles.astype(np.int64)
    row, column = np.divmod(texels.pixels.astype(np.int64), width)
    steps = (np.arange(samples_per_side) + 0.5) / samples_per_side
    # Axes: texel, sample, (x, y).
    steps = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    points = np.stack([column, row], axis=1)[:, None] + steps
    inside = texels.weights.astype(np.float64)[:, None]
    outwards = _compute_barycentric_weights(pages.corners[triangles], points) - inside
    far = np.linalg.norm(outwards @ mesh.vertices[mesh.triangles[triangles]], axis=2, keepdims=True)
    reach = _MAX_OVERSHOOT_TEXELS * texel_size
    weights = inside + outwards * (reach / np.maximum(far, reach))
    return np.repeat(triangles, samples_per_side**2), weights.reshape(-1, 3)


def _compute_barycentric_weights(corners: Floats, points: Floats) -> Floats:
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


def classify_sides(mesh: Mesh, pages: AtlasLayout) -> NDArray[np.uint8]:
    """Classify the side opposite each corner.

    The result, (m, 3) uint8, holds `INSIDE_CHART`, `CHART_BORDER` or
    `MESH_BOUNDARY`.
    """
    first, second = np.array([1, 2, 0]), np.array([2, 0, 1])
    ends = np.stack([mesh.triangles[:, first], mesh.triangles[:, second]], axis=-1).astype(np.int64)
    atlas_ends = np.stack([pages.corners[:, first], pages.corners[:, second]], axis=2)
    # Orient each side from its lower vertex index, so that both adjacent triangles give the same key.
    is_reversed = ends[..., 0] > ends[..., 1]
    ends[is_reversed], atlas_ends[is_reversed] = ends[is_reversed][:, ::-1], atlas_ends[is_reversed][:, ::-1]
    key = (ends[..., 0] * len(mesh.vertices) + ends[..., 1]).ravel()
    atlas_ends, images = atlas_ends.reshape(-1, 4), np.repeat(pages.pages, 3)
    order = np.argsort(key, kind="stable")
    a, b = order[:-1], order[1:]
    is_shared = key[a] == key[b]
    is_continuous = (
        is_shared
        & (images[a] == images[b])
        & (np.abs(atlas_ends[a] - atlas_ends[b]).max(axis=1) < _COINCIDENCE_TEXELS)
    )
    kinds = np.full(len(key), MESH_BOUNDARY, np.uint8)
    kinds[a[is_shared]] = kinds[b[is_shared]] = CHART_BORDER
    kinds[a[is_continuous]] = kinds[b[is_continuous]] = INSIDE_CHART
    return kinds.reshape(-1, 3)
