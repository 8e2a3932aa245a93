"""Estimation of the finest colour detail of a mesh."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import decode_material_image
from scanloom.stages.surface.texture import compute_signed_areas
from scanloom.stages.surface.topology import compute_areas

# Minimum samples per detail length of the original. More samples change the error by less than 0.1 dB on a
# scanned banana and a fused room.
SAMPLES_PER_DETAIL = 1.6
# Detail size relative to the mean edge length: colours interpolated between vertices have kinks along edges,
# and many edges are shorter than the mean.
_DETAIL_PER_EDGE = 0.4
# Limit of vertex-colour details, on average per triangle. A mesh of tiny triangles with a few large ones
# would otherwise need a huge image for a handful of colours, and minutes to bake it.
_MAX_DETAILS_PER_TRIANGLE = 2000


def estimate_mesh_detail(original: Mesh) -> float:
    """Estimate the size of the smallest colour detail of a mesh, metres.

    The size is the mean texel size if most of the area is textured, otherwise a fraction of the edge length.
    """
    area = compute_areas(original.vertices, original.triangles)
    texels = _count_triangle_texels(original)
    on_image = texels > 0
    if area[on_image].sum() > area.sum() / 2:
        return math.sqrt(area[on_image].sum() / texels.sum())
    return max(_DETAIL_PER_EDGE * float(_compute_edge_lengths(original).mean()), _compute_min_detail(area))


def estimate_triangle_details(original: Mesh) -> NDArray[np.float64]:
    """Estimate the colour detail size of each triangle (m,), metres; infinite without area."""
    area = compute_areas(original.vertices, original.triangles)
    texels = _count_triangle_texels(original)
    of_edges = np.maximum(
        _DETAIL_PER_EDGE * _compute_edge_lengths(original).mean(axis=1), _compute_min_detail(area)
    )
    of_texels = np.sqrt(np.divide(area, texels, out=np.zeros_like(area), where=texels > 0))
    return np.where(area > 0, np.where(texels > 0, of_texels, of_edges), np.inf)


def _count_triangle_texels(original: Mesh) -> NDArray[np.float64]:
    """Return the number of texels of each triangle (m,); 0 without an image."""
    texture = original.texture
    if texture is None:
        return np.zeros(len(original.triangles))
    images = [decode_material_image(material) for material in texture.materials]
    # The last entry is for triangles without a material (index −1).
    texels_of = np.array([*(_count_texels(image) for image in images), 0])
    return np.asarray(np.abs(compute_signed_areas(texture.uvs)) * texels_of[texture.material_ids])


def _compute_edge_lengths(original: Mesh) -> NDArray[np.float64]:
    corners = original.vertices[original.triangles]
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))


def _compute_min_detail(area: NDArray[np.float64]) -> float:
    return math.sqrt(area.sum() / (_MAX_DETAILS_PER_TRIANGLE * len(area)))


def _count_texels(image: NDArray[np.uint8] | None) -> int:
    """Count the texels of an image.

    A single texel counts as 0, because it has no detail even if it repeats.
    """
    count = 0 if image is None else image.shape[0] * image.shape[1]
    return count if count > 1 else 0
