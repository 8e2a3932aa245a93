"""Correspondence between the texels of a simplified mesh and points of the original surface.

Every vertex of the original is taken to the nearest point of the simplified mesh. With its vertices each
triangle comes into the atlas, where it is rasterised, at the cost of one query for each vertex. Triangles that
fold over or tear there are left out. Texels that stay empty get a query of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.surface.mesh import Mesh
from stages.surface.raycasting import Floats, Located, Surface, bounding_box, unit_normals
from stages.surface.texture import signed_areas
from stages.texturing.facing import FacingColors
from stages.texturing.pages import Pages, Texels, texels_of

# Largest stretch of an edge of the original in the atlas, relative to its length on the surface, and texels
# that are always allowed, as rounding weighs most where triangles are small.
_MAX_STRETCH = 2.0
_FREE_TEXELS = 2.0
# Cosine between a triangle and the plane of a chart that it extends beyond its border.
_MIN_ALIGNED = 0.8
# Texels looked up at a time: bounds the memory.
_AT_ONCE = 1 << 18


@dataclass(frozen=True, eq=False)
class TexelSources:
    """Points of the original surface that the texels of one image show.

    Attributes
    ----------
    texels : Texels of the simplified mesh.
    triangles : (n,) int32, triangle of the original for each texel.
    weights : (n, 3) float32, barycentric weights of its corners.
    turned_count : texels whose nearest point faced away, so that another one was taken.
    """

    texels: Texels
    triangles: NDArray[np.int32]
    weights: NDArray[np.float32]
    turned_count: int


@dataclass(frozen=True, eq=False)
class _Entries:
    """Triangles of the original in the atlas.

    Attributes
    ----------
    corners : (k, 3, 2) float64, texels.
    triangles : (k,) triangle of the original.
    charts, pages : (k,) of the simplified mesh.
    """

    corners: Floats
    triangles: NDArray[np.int64]
    charts: NDArray[np.int32]
    pages: NDArray[np.int32]


class Correspondence:
    """Finds the point of the original for each texel of a simplified mesh.

    Parameters
    ----------
    simplified : its box holds the original too.
    original : mesh.
    pages : atlas of the simplified mesh.
    """

    def __init__(self, simplified: Surface, original: Mesh, pages: Pages) -> None:
        self._simplified, self._original, self._pages = simplified, original, pages
        self._texel_size = pages.texel_size(simplified.mesh)
        self._entries = self._placed_triangles()
        self._facing: FacingColors | None = None

    def sources(self, page: int) -> TexelSources:
        """Return the sources of all texels of an image."""
        width, height = self._pages.sizes[page]
        texels = texels_of(self._pages, page)
        entries = self._entries
        drawn = _kernels.texels(entries.corners, entries.pages, page=page, width=width, height=height)
        # Row of each pixel in `drawn`, -1 for none.
        row_of = np.full(width * height, -1, np.int32)
        row_of[drawn[0]] = np.arange(len(drawn[0]), dtype=np.int32)
        rows = row_of[texels.pixels]
        entry = drawn[1][rows]
        is_found = (rows >= 0) & (entries.charts[entry] == self._pages.charts[texels.triangles])
        triangles = entries.triangles[entry].astype(np.int32)
        weights = drawn[2][rows]
        missing = np.flatnonzero(~is_found)
        turned_count = 0
        if len(missing):
            facing = self._facing_lookup()
            for start in range(0, len(missing), _AT_ONCE):
                some = missing[start : start + _AT_ONCE]
                found, shares, turned = facing.locate(
                    texels.triangles[some].astype(np.int64), texels.shares[some].astype(np.float64)
                )
                triangles[some], weights[some] = found, shares
                turned_count += turned
        return TexelSources(texels, triangles, weights, turned_count)

    def _facing_lookup(self) -> FacingColors:
        if self._facing is None:
            box = bounding_box(self._original, self._simplified.mesh)
            self._facing = FacingColors(Surface(self._original, box), self._simplified.mesh, self._texel_size)
        return self._facing

    def _placed_triangles(self) -> _Entries:
        """Place the triangles of the original in the atlas, in the order in which they are drawn."""
        mesh, pages = self._original, self._pages
        located, is_facing = self._nearest_of_vertices()
        corner_charts = np.where(is_facing, pages.charts[located.triangles], -1)[mesh.triangles]
        is_usable = (corner_charts >= 0).all(axis=1)
        is_whole = is_usable & (corner_charts == corner_charts[:, :1]).all(axis=1)
        at = np.einsum("kc,kcx->kx", located.weights, pages.corners[located.triangles])
        parts = [self._crossing(np.flatnonzero(is_usable & ~is_whole), corner_charts, located, at)]
        whole = np.flatnonzero(is_whole)
        # What is near the simplified mesh is drawn last, over what may be another layer of the original.
        distance = located.distances[mesh.triangles[whole]].max(axis=1)
        whole = whole[np.argsort(-distance, kind="stable")]
        first = located.triangles[mesh.triangles[whole, 0]]
        parts.append(_Entries(at[mesh.triangles[whole]], whole, corner_charts[whole, 0], pages.pages[first]))
        joined = _Entries(
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("corners", "triangles", "charts", "pages")
            )
        )
        return self._sound(joined, located)

    def _nearest_of_vertices(self) -> tuple[Located, NDArray[np.bool_]]:
        """Return the nearest point of the simplified mesh for each vertex, and whether it faces alike."""
        mesh = self._original
        normals = _vertex_normals(mesh)
        points, inverse = np.unique(mesh.vertices, axis=0, return_inverse=True)
        found = self._simplified.closest(points)
        inverse = inverse.reshape(-1)
        located = Located(found.triangles[inverse], found.weights[inverse], found.distances[inverse])
        faces = np.einsum("kx,kx->k", normals, self._simplified.normals[located.triangles]) > 0
        return located, faces

    def _crossing(
        self,
        triangles: NDArray[np.int64],
        corner_charts: NDArray[np.int32],
        located: Located,
        at: Floats,
    ) -> _Entries:
        """Place triangles of several charts once in each chart, extended beyond its border."""
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
            # Around an edge that is too sharp, nothing lies where the plane of the chart goes on.
            aligned = np.einsum("kx,kx->k", own_normals[triangles[rows]], self._simplified.normals[base])
            is_flat = aligned > _MIN_ALIGNED
            rows, base, corners = rows[is_flat], base[is_flat], corners[is_flat]
            found.append(
                _Entries(corners, triangles[rows], charts[rows, k].astype(np.int32), pages.pages[base])
            )
        return _Entries(
            *(
                np.concatenate([getattr(part, name) for part in found])
                for name in ("corners", "triangles", "charts", "pages")
            )
        )

    def _sound(self, entries: _Entries, located: Located) -> _Entries:
        """Leave out triangles that fold over or are torn in the atlas."""
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
        )


def _vertex_normals(mesh: Mesh) -> Floats:
    """Return normals (n, 3) of the vertices as sums over their triangles, alike for copies in one place."""
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
    """Return barycentric weights (k, 3) of the feet of points in the planes of triangles (k, 3, 3)."""
    a = corners[:, 0]
    ab, ac, ap = corners[:, 1] - a, corners[:, 2] - a, points - a
    normal = np.cross(ab, ac)
    squared = np.einsum("kx,kx->k", normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        v = np.einsum("kx,kx->k", np.cross(ap, ac), normal) / squared
        w = np.einsum("kx,kx->k", np.cross(ab, ap), normal) / squared
    return np.stack([1 - v - w, v, w], axis=1)
