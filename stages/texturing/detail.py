"""How fine the colours of an original are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.color import pixels_of
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import signed_areas
from scanloom.stages.surface.topology import areas

# Samples in a length of one detail of the original, at least. On a scanned banana and a fused room more of
# them change the error by less than 0.1 dB.
SAMPLES_PER_DETAIL = 1.6
# Of the mean edge: what is interpolated between vertices has kinks along edges, many of them shorter.
_DETAIL_OF_EDGE = 0.4
# An original has no more details than this in a triangle, by its vertex colours: where a few triangles are
# large among tiny ones, an image that shows these everywhere would take minutes for a handful of colours.
_DETAILS_OF_TRIANGLE = 2000


def detail_of(original: Mesh) -> float:
    """Return the size, in metres, of the smallest thing the original's colours can show."""
    area = areas(original.vertices, original.triangles)
    texels = _texels(original)
    on_image = texels > 0
    # Where most of the surface has a texture, that is what there is to keep.
    if area[on_image].sum() > area.sum() / 2:
        return math.sqrt(area[on_image].sum() / texels.sum())
    return max(_DETAIL_OF_EDGE * float(_lengths(original).mean()), _least(area))


def details_of(original: Mesh) -> NDArray[np.float64]:
    """Return the same of each triangle (m,); infinite for those without area."""
    area = areas(original.vertices, original.triangles)
    texels = _texels(original)
    of_edges = np.maximum(_DETAIL_OF_EDGE * _lengths(original).mean(axis=1), _least(area))
    of_texels = np.sqrt(np.divide(area, texels, out=np.zeros_like(area), where=texels > 0))
    return np.where(area > 0, np.where(texels > 0, of_texels, of_edges), np.inf)


def _texels(original: Mesh) -> NDArray[np.float64]:
    """Return how many texels each triangle (m,) has in its image; 0 for those without one."""
    texture = original.texture
    if texture is None:
        return np.zeros(len(original.triangles))
    images = [pixels_of(material) for material in texture.materials]
    # The last one stands for triangles without a material.
    texels_of = np.array([*(_texel_count(image) for image in images), 0])
    return np.asarray(np.abs(signed_areas(texture.uvs)) * texels_of[texture.material_ids])


def _lengths(original: Mesh) -> NDArray[np.float64]:
    corners = original.vertices[original.triangles]
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))


def _least(area: NDArray[np.float64]) -> float:
    return math.sqrt(area.sum() / (_DETAILS_OF_TRIANGLE * len(area)))


def _texel_count(image: NDArray[np.uint8] | None) -> int:
    """Return how many texels show a detail: a single one has none, however often it is repeated."""
    count = 0 if image is None else image.shape[0] * image.shape[1]
    return count if count > 1 else 0
