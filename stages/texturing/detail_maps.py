"""Maps of the details of an original surface for its simplified mesh.

Normal maps are in the tangent space of the simplified mesh, as glTF requires: MikkTSpace frames, green up,
8 bits per channel. Displacements are along the interpolated normals of the simplified mesh.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box
from scanloom.stages.texturing.ambient_occlusion import RAYS_PER_TEXEL, compute_occlusion
from scanloom.stages.texturing.atlas_layout import AtlasLayout
from scanloom.stages.texturing.correspondence import Correspondence, TexelPoints, locate_vertices
from scanloom.stages.texturing.gap_filling import fill_gaps_smoothly, find_nearest_filled
from scanloom.stages.texturing.shading_normals import ShadingNormals
from scanloom.stages.texturing.tangent_frames import compute_tangent_frames, encode_normals

Pixels = NDArray[np.uint8]

_FLAT_NORMAL = (128, 128, 255)
# Texels transformed per batch: bounds memory.
_BATCH_TEXELS = 1 << 18
# Rays for all occlusion maps together. It bounds the time: one core casts about a million rays per second.
_MAX_RAYS = 1.6e7
# Maximum distance of a point of the original from the normal through its texel, in texels.
_MAX_LATERAL_TEXELS = 1.0
# Default distance of occluding surface, as a ratio of the diagonal of the bounding box.
_OCCLUSION_RATIO = 0.1


@dataclass(frozen=True, eq=False)
class _PagePoints:
    """Points of both meshes at the texels of an image.

    Attributes
    ----------
    size : width and height of the image.
    is_filled : (h, w) bool, texels with a point.
    sources : points of the original.
    own : points of the simplified mesh at the same texels.
    """

    size: tuple[int, int]
    is_filled: NDArray[np.bool_]
    sources: TexelPoints
    own: TexelPoints

    def split(self) -> Iterator[tuple[TexelPoints, TexelPoints]]:
        """Yield both points in batches."""
        for start in range(0, len(self.sources.texels), _BATCH_TEXELS):
            rows = slice(start, start + _BATCH_TEXELS)
            yield self.sources[rows], self.own[rows]


class DetailBaker:
    """Baker of detail maps.

    Parameters
    ----------
    simplified : mesh with normals.
    original : the detailed mesh.
    pages : atlas of the simplified mesh.
    """

    def __init__(self, simplified: Mesh, original: Mesh, pages: AtlasLayout) -> None:
        self.simplified, self.original, self.pages = simplified, original, pages
        self.original_normals = ShadingNormals(original)
        self.frames = compute_tangent_frames(simplified, pages.uvs)
        self._vertices = locate_vertices(simplified, original)
        self._points: dict[int, list[_PagePoints]] = {}

    @cached_property
    def max_factor(self) -> int:
        """Largest factor by which images can be reduced: borders of charts need a texel between them."""
        factor = 1
        while 2 * factor <= self.pages.padding and all(
            side % (2 * factor) == 0 for size in self.pages.sizes for side in size
        ):
            factor *= 2
        return factor

    def bake_normals(self, factor: int = 1) -> list[Pixels]:
        """Bake a normal map (h, w, 3) for each image, smaller by a factor along each side."""
        images = []
        for page in self._locate(factor):
            width, height = page.size
            levels = np.empty((height * width, 3), np.float32)
            levels[:] = _FLAT_NORMAL
            for sources, own in page.split():
                directions = self.original_normals(sources.triangles, sources.weights)
                frame = self.frames.interpolate(own.triangles, own.weights)
                levels[sources.texels] = encode_normals(directions, frame)
            padding = max(self.pages.padding // factor, 1)
            images.append(fill_gaps_smoothly(levels.reshape(height, width, 3), page.is_filled, padding))
        return images

    def bake_displacements(self) -> list[NDArray[np.float32]]:
        """Bake the height (h, w) of the original over the simplified mesh for each image, metres."""
        images = []
        max_offset = _MAX_LATERAL_TEXELS * self.pages.compute_mean_texel_size(self.simplified)
        for page in self._locate(1):
            width, height = page.size
            heights = np.zeros(height * width, np.float32)
            is_above = np.zeros(height * width, bool)
            for sources, own in page.split():
                along = self.frames.interpolate(own.triangles, own.weights)[2]
                along = along / np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
                away = _locate_points(self.original, sources) - _locate_points(self.simplified, own)
                found = np.einsum("kx,kx->k", away, along)
                heights[sources.texels] = found
                lateral = np.linalg.norm(away - found[:, None] * along, axis=1)
                is_above[sources.texels] = lateral <= max_offset
            if is_above.any():
                # Points that are not above the texel are at folds and borders; their heights are of other
                # surface.
                _, nearest = find_nearest_filled(is_above.reshape(height, width))
                heights = heights[nearest.reshape(-1)]
            images.append(heights.reshape(height, width))
        return images

    def bake_occlusion(self, max_distance: float | None = None) -> list[Pixels]:
        """Bake an ambient occlusion map (h, w, 3) for each image.

        Maps are smaller than the images if these have too many texels.

        Parameters
        ----------
        max_distance : surface beyond this distance does not occlude, metres. Default: a tenth of the diagonal
            of the bounding box.
        """
        box = compute_bounding_box(self.original)
        surface = RaycastingSurface(self.original, box)
        distance = max_distance or _OCCLUSION_RATIO * float(np.linalg.norm(box[1] - box[0]))
        texels = sum(width * height for width, height in self.pages.sizes)
        factor = 1
        while factor < self.max_factor and texels * RAYS_PER_TEXEL > _MAX_RAYS * factor**2:
            factor *= 2
        images = []
        for page in self._locate(factor):
            charts = self.pages.charts[page.own.triangles]
            shade = compute_occlusion(
                surface, self.original_normals, page.sources, charts, page.size, distance
            )
            levels = np.repeat(shade[:, :, None], 3, axis=2).astype(np.float32)
            images.append(fill_gaps_smoothly(levels, page.is_filled, max(self.pages.padding // factor, 1)))
        return images

    def _locate(self, factor: int) -> list[_PagePoints]:
        """Locate the points of all texels of the images, smaller by a factor; the last factor is kept."""
        found = self._points.get(factor)
        if found is None:
            pages = self.pages.reduce(factor)
            correspondence = Correspondence(self.simplified, self.original, pages, self._vertices)
            found = []
            for number, size in enumerate(pages.sizes):
                sources = correspondence.find_sources(number)
                points = sources.points
                own = correspondence.locate_texels(number, points.texels)
                found.append(_PagePoints(size, sources.is_filled, points, own))
            # Another thread may locate the points of another factor.
            self._points = {factor: found}
        return found


def encode_displacements(
    heights: Sequence[NDArray[np.float32]],
) -> tuple[list[NDArray[np.uint16]], float]:
    """Encode displacements in 16 bits.

    Returns
    -------
    Images, in which 32768 is no displacement, and the displacement in metres of 32767 steps.
    """
    scale = max((float(np.abs(one).max()) for one in heights), default=0.0)
    steps = 32767 / scale if scale > 0 and math.isfinite(scale) else 0.0
    return [np.rint(32768 + steps * one).astype(np.uint16) for one in heights], scale


def _locate_points(mesh: Mesh, points: TexelPoints) -> NDArray[np.float64]:
    corners = mesh.vertices[mesh.triangles[points.triangles]]
    return np.asarray(np.einsum("kc,kcx->kx", points.weights.astype(np.float64), corners))
