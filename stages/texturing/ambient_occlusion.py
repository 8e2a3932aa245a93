"""Ambient occlusion at surface points of an atlas, by ray casting.

Rays are cosine-weighted: the result is the ratio of uniform ambient light that reaches a point. Each texel of
a 4 × 4 block casts a sixteenth of 256 stratified rays (interleaved sampling, Keller and Heidrich 2001). A
filter of the width of the block then averages all 256 directions, within parts of a chart that face the same
way.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box
from scanloom.stages.texturing.correspondence import TexelPoints

_Floats = NDArray[np.float32]

# Side of the block of texels that share all directions, and strata per side of the directions of a texel.
_BLOCK_SIDE = 4
_STRATA = 4
RAYS_PER_TEXEL = _STRATA**2
# Filter along each axis. It averages four consecutive texels, then two, so that a pattern with a period of
# four texels disappears and the image is not shifted.
_FILTER = (1, 2, 2, 2, 1)
# Minimum cosine between normals of texels that are averaged.
_MIN_FILTER_COSINE = 0.8
# Distance of ray origins from the surface, against hits of the triangle itself; a ratio of the diagonal of
# the bounding box.
_OFFSET_RATIO = 1e-4
# Rays per call, at about 100 bytes each: bounds memory.
_BATCH_RAYS = 1 << 20


def compute_occlusion(
    surface: RaycastingSurface,
    normals_of: Callable[[NDArray[np.integer], NDArray[np.floating]], _Floats],
    points: TexelPoints,
    charts: NDArray[np.int32],
    size: tuple[int, int],
    max_distance: float,
) -> NDArray[np.uint8]:
    """Compute ambient occlusion, (h, w) uint8; 255 where no surface is near.

    The result is deterministic.

    Parameters
    ----------
    surface : the detailed mesh, which occludes itself.
    normals_of : shading normals of the detailed mesh.
    points : points of the detailed mesh at texels.
    charts : (n,) chart of each of the texels.
    size : width and height of the image, texels.
    max_distance : surface beyond this distance does not occlude, metres.
    """
    width, height = size
    visible = np.ones(height * width, np.float32)
    normals = np.zeros((height * width, 3), np.float32)
    chart_of = np.full(height * width, -1, np.int32)
    chart_of[points.texels] = charts
    low, high = compute_bounding_box(surface.mesh)
    offset = _OFFSET_RATIO * float(np.linalg.norm(high - low))
    directions = _make_directions()
    mesh = surface.mesh
    step = _BATCH_RAYS // RAYS_PER_TEXEL
    for start in range(0, len(points.texels), step):
        rows = slice(start, start + step)
        texels, triangles, weights = points.texels[rows], points.triangles[rows], points.weights[rows]
        own = normals_of(triangles, weights)
        corners = mesh.vertices[mesh.triangles[triangles]]
        origins = np.einsum("kc,kcx->kx", weights.astype(np.float64), corners)
        origins += offset * own.astype(np.float64)
        row, column = np.divmod(texels, width)
        local = directions[(row % _BLOCK_SIDE) * _BLOCK_SIDE + column % _BLOCK_SIDE]
        tangents, bitangents = _make_bases(own)
        rays = (
            local[:, :, :1] * tangents[:, None]
            + local[:, :, 1:2] * bitangents[:, None]
            + local[:, :, 2:] * own[:, None]
        )
        hidden = surface.are_occluded(
            np.repeat(origins, RAYS_PER_TEXEL, axis=0), rays.reshape(-1, 3), max_distance
        )
        visible[texels] = 1 - hidden.reshape(-1, RAYS_PER_TEXEL).mean(axis=1, dtype=np.float32)
        normals[texels] = own
    smooth = _filter(
        visible.reshape(height, width), normals.reshape(height, width, 3), chart_of.reshape(height, width)
    )
    return np.asarray(np.rint(255 * smooth), np.uint8)


def _make_directions() -> _Floats:
    """Make cosine-weighted directions (16, 16, 3) for the texels of a block, z along the normal.

    All directions of a block together are the centres of 16 × 16 equal cells of the unit square.
    """
    cells = np.arange(_STRATA) / _STRATA
    shifts = (np.arange(_BLOCK_SIDE) + 0.5) / (_STRATA * _BLOCK_SIDE)
    u = (shifts[:, None, None, None] + cells[None, None, :, None]) + np.zeros((1, _BLOCK_SIDE, 1, _STRATA))
    v = (shifts[None, :, None, None] + cells[None, None, None, :]) + np.zeros((_BLOCK_SIDE, 1, _STRATA, 1))
    radius, angle = np.sqrt(u), 2 * np.pi * v
    found = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - u)], axis=-1)
    return found.reshape(_BLOCK_SIDE**2, RAYS_PER_TEXEL, 3).astype(np.float32)


def _make_bases(normals: _Floats) -> tuple[_Floats, _Floats]:
    """Make two unit vectors perpendicular to each normal (Duff et al. 2017)."""
    x, y, z = normals.T
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    tangents = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    bitangents = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.asarray(tangents, np.float32), np.asarray(bitangents, np.float32)


def _filter(values: _Floats, normals: _Floats, charts: NDArray[np.int32]) -> _Floats:
    """Average values (h, w) over texels of the same chart that face the same way."""
    reach = len(_FILTER) // 2
    height, width = values.shape
    total, weight_sum = np.zeros_like(values), np.zeros_like(values)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            here = (
                slice(max(0, -dy), height - max(0, dy)),
                slice(max(0, -dx), width - max(0, dx)),
            )
            there = (
                slice(max(0, dy), height - max(0, -dy)),
                slice(max(0, dx), width - max(0, -dx)),
            )
            is_same = charts[here] == charts[there]
            is_same &= np.einsum("ijx,ijx->ij", normals[here], normals[there]) > _MIN_FILTER_COSINE
            weight = np.float32(_FILTER[dy + reach] * _FILTER[dx + reach]) * is_same
            total[here] += weight * values[there]
            weight_sum[here] += weight
    return np.where(weight_sum > 0, total / np.maximum(weight_sum, 1), values)
