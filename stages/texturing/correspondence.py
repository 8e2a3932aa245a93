"""Correspondence between texels of a simplified mesh and the original surface.

Every vertex of the original is taken to the nearest point of the simplified mesh. With its vertices each
triangle comes into the atlas, where it is rasterised, at the cost of one query for each vertex. Triangles
that fold over or tear there are left out. Texels that stay empty get a query of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages._opencv import require_opencv
from stages.surface.mesh import Mesh
from stages.surface.raycasting import (
    Floats,
    Located,
    Surface,
    bounding_box,
    closest_weights,
    unit_normals,
)
from stages.surface.texture import signed_areas
from stages.texturing.facing import FacingColors
from stages.texturing.pages import Pages

# Largest stretch of an edge of the original in the atlas, relative to its length on the surface, and texels
# that are always allowed, as rounding weighs most where triangles are small.
_MAX_STRETCH = 2.0
_FREE_TEXELS = 2.0
# Cosine between a triangle and the plane of a chart that it extends, below which its texels are checked.
_MIN_ALIGNED = 0.8
# The same for triangles within a chart.
_MIN_ALIGNED_WITHIN = 0.6
# Largest distance of such a texel from its source, in distances of the vertices plus as many texels.
_MAX_DETOUR = 1.5
# Texels looked up at a time: bounds the memory.
_AT_ONCE = 1 << 18
# Around a texel, the nearest first.
_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
# Bits of the fraction of a coordinate that OpenCV draws with, and charts that 16 bits can number.
_FRACTION, _MAX_LABEL = 8, (1 << 16) - 2


@dataclass(frozen=True, eq=False)
class TexelSources:
    """Points of the original surface that the texels of one image show.

    Attributes
    ----------
    pixels : (n,) uint32, row × width + column; of several for one texel the last one counts.
    triangles : (n,) int32, triangle of the original for each texel.
    weights : (n, 3) float32, barycentric weights of its corners.
    is_filled : (h · w,) bool, texels of charts, with one around each; what others show is of no use.
    turned_count : texels whose nearest point faced away, so that another one was taken.
    run_triangles, run_lengths : (k,) triangles of the first texels, and how many texels of each follow each
        other; all further texels were looked up.
    """

    pixels: NDArray[np.uint32]
    triangles: NDArray[np.int32]
    weights: NDArray[np.float32]
    is_filled: NDArray[np.bool_]
    turned_count: int
    run_triangles: NDArray[np.int64]
    run_lengths: NDArray[np.int64]

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values (m,) of the original triangles for the texels (n,)."""
        # Repeating is several times as fast as looking up.
        found = np.repeat(values[self.run_triangles], self.run_lengths)
        rest = self.triangles[len(found) :]
        return np.concatenate([found, values[rest]]) if len(rest) else found


@dataclass(frozen=True, eq=False)
class _Entries:
    """Triangles of the original in the atlas.

    Attributes
    ----------
    corners : (k, 3, 2) float64, texels.
    triangles : (k,) triangle of the original.
    charts, pages : (k,) of the simplified mesh.
    is_doubtful : (k,) whether it is extended around a sharp edge, so that each of its texels is checked.
    """

    corners: Floats
    triangles: NDArray[np.int64]
    charts: NDArray[np.int32]
    pages: NDArray[np.int32]
    is_doubtful: NDArray[np.bool_]


class Correspondence:
    """Lookup of the original surface under the texels of a simplified mesh.

    Parameters
    ----------
    simplified : its box holds the original too.
    original : mesh.
    pages : atlas of the simplified mesh.
    """

    def __init__(self, simplified: Surface, original: Mesh, pages: Pages) -> None:
        self._simplified, self._original, self._pages = simplified, original, pages
        self._texel_size = pages.texel_size(simplified.mesh)
        self._entries = self._place_triangles()
        self._facing: FacingColors | None = None
        self._triangle_images: dict[int, NDArray[np.int32]] = {}

    def find_sources(self, page: int) -> TexelSources:
        """Find the point of the original for each texel of an image."""
        width, height = self._pages.sizes[page]
        charts = self._draw_charts(page).reshape(-1)
        entries = self._entries
        pixels, drawn, weights = _kernels.texels(
            entries.corners, entries.pages, page=page, width=width, height=height
        )
        # Texels are in the order of the triangles.
        counts = np.bincount(drawn, minlength=len(entries.triangles))
        triangles = np.repeat(entries.triangles.astype(np.int32), counts)
        shown = np.zeros_like(charts)
        shown[pixels] = np.repeat(entries.charts.astype(charts.dtype) + charts.dtype.type(1), counts)
        doubtful = np.flatnonzero(np.repeat(entries.is_doubtful, counts))
        is_far = self._is_far(page, pixels[doubtful], triangles[doubtful], weights[doubtful])
        shown[pixels[doubtful[is_far]]] = 0
        is_filled = charts > 0
        missing = np.flatnonzero(is_filled & (shown != charts)).astype(np.uint32)
        if not len(missing):
            return TexelSources(pixels, triangles, weights, is_filled, 0, entries.triangles, counts)
        own_triangles, shares = self.locate_texels(page, missing)
        facing = self._get_facing_lookup()
        found, found_weights, turned_count = [triangles], [weights], 0
        for start in range(0, len(missing), _AT_ONCE):
            rows = slice(start, start + _AT_ONCE)
            some, some_weights, turned = facing.locate(
                own_triangles[rows].astype(np.int64), shares[rows].astype(np.float64)
            )
            found.append(some.astype(np.int32))
            found_weights.append(some_weights.astype(np.float32))
            turned_count += turned
        return TexelSources(
            np.concatenate([pixels, missing]),
            np.concatenate(found),
            np.concatenate(found_weights),
            is_filled,
            turned_count,
            entries.triangles,
            counts,
        )

    def locate_texels(
        self, page: int, pixels: NDArray[np.uint32]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Locate texels on the simplified mesh: triangles (k,) and weights (k, 3).

        A texel beside a chart gets the nearest point of its border.
        """
        width = self._pages.sizes[page][0]
        row, column = np.divmod(pixels.astype(np.int32), np.int32(width))
        triangles = self._find_triangles(page, row, column)
        flat = np.zeros((len(pixels), 3, 3))
        flat[..., :2] = self._pages.corners[triangles]
        points = np.stack([column + 0.5, row + 0.5, np.zeros(len(pixels))], axis=1)
        return triangles, closest_weights(points, flat).astype(np.float32)

    def _is_far(
        self,
        page: int,
        pixels: NDArray[np.uint32],
        triangles: NDArray[np.int32],
        weights: NDArray[np.float32],
    ) -> NDArray[np.bool_]:
        """Mark texels that are far from the points of the original they show."""
        own, shares = self.locate_texels(page, pixels)
        mesh, original = self._simplified.mesh, self._original
        points = np.einsum("kc,kcx->kx", shares, mesh.vertices[mesh.triangles[own]])
        shown = np.einsum("kc,kcx->kx", weights, original.vertices[original.triangles[triangles]])
        allowed = self._distances[original.triangles[triangles]].max(axis=1)
        distances = np.linalg.norm(points - shown, axis=1)
        return np.asarray(distances > _MAX_DETOUR * allowed + _MAX_DETOUR * self._texel_size)

    def _find_triangles(
        self, page: int, row: NDArray[np.int32], column: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """Find the triangle of the simplified mesh at each texel or its neighbours."""
        if page not in self._triangle_images:
            numbers = np.arange(len(self._pages.charts), dtype=np.int32)
            self._triangle_images[page] = self._draw_triangles(page, numbers, np.dtype(np.int32))
        image = self._triangle_images[page]
        found = image[row, column]
        for down, right in _NEIGHBOURS:
            (left,) = np.nonzero(found == 0)
            if not len(left):
                break
            rows = (row[left] + down).clip(0, image.shape[0] - 1)
            found[left] = image[rows, (column[left] + right).clip(0, image.shape[1] - 1)]
        return np.asarray((found - 1).clip(0), np.int32)

    def _draw_charts(self, page: int) -> NDArray[Any]:
        """Draw the index of each chart plus 1, (h, w); 0 marks gaps."""
        require_opencv()
        import cv2

        kind = np.uint16 if self._pages.charts.max() < _MAX_LABEL else np.float32
        image = self._draw_triangles(page, self._pages.charts, np.dtype(kind))
        # Bilinear samples at a border reach one texel further. Padding keeps charts farther apart than that.
        spread: NDArray[Any] = np.asarray(
            cv2.dilate(image, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
        )
        return spread

    def _draw_triangles(self, page: int, values: NDArray[np.int32], kind: np.dtype[Any]) -> NDArray[Any]:
        """Draw the triangles of an atlas image with their values plus 1."""
        require_opencv()
        import cv2

        width, height = self._pages.sizes[page]
        image = np.zeros((height, width), kind)
        chosen = np.flatnonzero(self._pages.pages == page)
        # Texel centres lie at halves.
        fixed = np.rint((self._pages.corners[chosen] - 0.5) * (1 << _FRACTION)).astype(np.int32)
        for corners, value in zip(fixed, (values[chosen] + 1).tolist(), strict=True):
            cv2.fillConvexPoly(image, corners, value, shift=_FRACTION)
        return image

    def _get_facing_lookup(self) -> FacingColors:
        if self._facing is None:
            box = bounding_box(self._original, self._simplified.mesh)
            self._facing = FacingColors(Surface(self._original, box), self._simplified.mesh, self._texel_size)
        return self._facing

    def _place_triangles(self) -> _Entries:
        """Place the triangles of the original in the atlas, in drawing order."""
        mesh, pages = self._original, self._pages
        located, is_facing = self._find_nearest()
        self._distances = located.distances
        corner_charts = np.where(is_facing, pages.charts[located.triangles], -1)[mesh.triangles]
        is_usable = (corner_charts >= 0).all(axis=1)
        is_whole = is_usable & (corner_charts == corner_charts[:, :1]).all(axis=1)
        at = np.einsum("kc,kcx->kx", located.weights, pages.corners[located.triangles])
        parts = [self._place_crossing(np.flatnonzero(is_usable & ~is_whole), corner_charts, located, at)]
        whole = np.flatnonzero(is_whole)
        # What is near the simplified mesh is drawn last, over what may be another layer of the original.
        distance = located.distances[mesh.triangles[whole]].max(axis=1)
        whole = whole[np.argsort(-distance, kind="stable")]
        first = located.triangles[mesh.triangles[whole, 0]]
        under = self._simplified.normals[located.triangles[mesh.triangles[whole]]]
        aligned = np.einsum("kx,kcx->kc", unit_normals(mesh)[whole], under)
        is_doubtful = (aligned < _MIN_ALIGNED_WITHIN).any(axis=1)
        parts.append(
            _Entries(
                at[mesh.triangles[whole]], whole, corner_charts[whole, 0], pages.pages[first], is_doubtful
            )
        )
        joined = _Entries(
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in _Entries.__dataclass_fields__
            )
        )
        return self._remove_unsound(joined, located)

    def _find_nearest(self) -> tuple[Located, NDArray[np.bool_]]:
        """Find the nearest simplified point of each vertex, and compare normals."""
        mesh = self._original
        normals = _vertex_normals(mesh)
        points, inverse = np.unique(mesh.vertices, axis=0, return_inverse=True)
        found = self._simplified.closest(points)
        inverse = inverse.reshape(-1)
        located = Located(found.triangles[inverse], found.weights[inverse], found.distances[inverse])
        faces = np.einsum("kx,kx->k", normals, self._simplified.normals[located.triangles]) > 0
        return located, faces

    def _place_crossing(
        self,
        triangles: NDArray[np.int64],
        corner_charts: NDArray[np.int32],
        located: Located,
        at: Floats,
    ) -> _Entries:
        """Place chart-crossing triangles in each of their charts, extended beyond the border."""
        mesh, pages, light = self._original, self._pages, self._simplified.mesh
        corners_of = mesh.triangles[triangles]
        charts = corner_charts[triangles]
        own_normals = unit_normals(mesh)
        found = []
        for k in range(3):
            # Each chart once: where it is that of an earlier corner too, it was handled there.
            is_new = np.ones(len(triangles), bool)
            for j in range(k):
                is_new &= charts[:, j] != charts[:, k]
            rows = np.flatnonzero(is_new)
            base = located.triangles[corners_of[rows, k]]
            plane = light.vertices[light.triangles[base]]
            corners = np.empty((len(rows), 3, 2))
            for j in range(3):
                vertices = corners_of[rows, j]
                weights = _plane_weights(mesh.vertices[vertices], plane)
                extended = np.einsum("kc,kcx->kx", weights, pages.corners[base])
                is_here = (charts[rows, j] == charts[rows, k])[:, None]
                corners[:, j] = np.where(is_here, at[vertices], extended)
            aligned = np.einsum("kx,kx->k", own_normals[triangles[rows]], self._simplified.normals[base])
            found.append(
                _Entries(
                    corners,
                    triangles[rows],
                    charts[rows, k].astype(np.int32),
                    pages.pages[base],
                    aligned < _MIN_ALIGNED,
                )
            )
        return _Entries(
            *(
                np.concatenate([getattr(part, name) for part in found])
                for name in _Entries.__dataclass_fields__
            )
        )

    def _remove_unsound(self, entries: _Entries, located: Located) -> _Entries:
        """Remove triangles that fold over or tear in the atlas."""
        mesh = self._original
        spread = signed_areas(entries.corners)
        # Charts may be mirrored: their own triangles say which way round is right.
        own = signed_areas(self._pages.corners)
        sign = np.zeros(int(self._pages.charts.max()) + 1)
        is_laid = self._pages.charts >= 0
        np.add.at(sign, self._pages.charts[is_laid], own[is_laid])
        is_upright = spread * np.sign(sign[entries.charts]) > 0
        corners = mesh.vertices[mesh.triangles[entries.triangles]]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2) / self._texel_size
        placed = np.linalg.norm(entries.corners - np.roll(entries.corners, 1, axis=1), axis=2)
        away = located.distances[mesh.triangles[entries.triangles]].max(axis=1) / self._texel_size
        is_torn = (placed > _MAX_STRETCH * sides + _FREE_TEXELS + away[:, None]).any(axis=1)
        kept = np.flatnonzero(is_upright & ~is_torn & np.isfinite(entries.corners).all(axis=(1, 2)))
        return _Entries(
            np.ascontiguousarray(entries.corners[kept]),
            entries.triangles[kept],
            entries.charts[kept],
            np.ascontiguousarray(entries.pages[kept], np.int32),
            entries.is_doubtful[kept],
        )


def _vertex_normals(mesh: Mesh) -> Floats:
    """Sum the triangle normals at each position; copies of a vertex get equal sums."""
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    place = place.reshape(-1)
    corners = mesh.vertices[mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at = place[mesh.triangles].reshape(-1)
    sums = np.stack(
        [np.bincount(at, np.repeat(across[:, axis], 3), minlength=len(mesh.vertices)) for axis in range(3)],
        axis=1,
    )
    return np.asarray(sums[place])


def _plane_weights(points: Floats, corners: Floats) -> Floats:
    """Project points to triangle planes and return barycentric weights (k, 3)."""
    a = corners[:, 0]
    ab, ac, ap = corners[:, 1] - a, corners[:, 2] - a, points - a
    normal = np.cross(ab, ac)
    squared = np.einsum("kx,kx->k", normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        v = np.einsum("kx,kx->k", np.cross(ap, ac), normal) / squared
        w = np.einsum("kx,kx->k", np.cross(ab, ap), normal) / squared
    return np.stack([1 - v - w, v, w], axis=1)
