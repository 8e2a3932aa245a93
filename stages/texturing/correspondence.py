"""Correspondence between texels of a simplified mesh and the original surface.

Each vertex of the original is projected to the nearest point of the simplified mesh, and so to a position in
the atlas. The triangles of the original are rasterised there. This costs one nearest-point query per vertex
instead of one per texel. Triangles that fold over or tear in the atlas are skipped. Texels that stay empty
get separate queries.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.surface.equal_positions import find_equal_positions
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import ClosestPoints, Floats, compute_triangle_normals
from scanloom.stages.surface.texture import compute_signed_areas
from scanloom.stages.texturing.atlas_layout import AtlasLayout
from scanloom.stages.texturing.color_lookup import DISTANCE_PROBES, INWARD_OFFSET_TEXELS, move_inwards

Pixels = NDArray[np.uint8]

# Maximum stretch of an edge of the original in the atlas, relative to its length on the surface. The
# additional texels are always allowed because rounding dominates in small triangles.
_MAX_STRETCH = 2.0
_STRETCH_TOLERANCE_TEXELS = 2.0
# Minimum cosine between a triangle and the chart plane it is extended onto. Texels of less aligned triangles
# are checked for their distance.
_MIN_CROSSING_COSINE = 0.8
# The same minimum cosine for triangles that are inside one chart.
_MIN_INSIDE_COSINE = 0.6
# Maximum distance of a checked texel from its source point, relative to the vertex distance plus a texel.
_MAX_DISTANCE_RATIO = 1.5
# Texels looked up per batch: bounds memory.
_BATCH_TEXELS = 1 << 18


@dataclass(frozen=True, eq=False)
class VertexLocations:
    """Nearest points of the simplified mesh to the vertices of the original.

    Attributes
    ----------
    nearest : nearest point of each vertex (n,).
    is_facing : (n,) bool, normals of the vertex and of the nearest triangle agree (angle below 90°).
    """

    nearest: ClosestPoints
    is_facing: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class TexelPoints:
    """Surface points at texels.

    Attributes
    ----------
    texels : (n,) int64, row × width + column.
    triangles : (n,) int32.
    weights : (n, 3) float32, barycentric weights of the corners.
    """

    texels: NDArray[np.int64]
    triangles: NDArray[np.int32]
    weights: NDArray[np.float32]

    def __getitem__(self, rows: NDArray[np.bool_] | slice) -> TexelPoints:
        """Return the points selected by a mask (n,) or a slice."""
        return TexelPoints(self.texels[rows], self.triangles[rows], self.weights[rows])


@dataclass(frozen=True, eq=False)
class TexelSources:
    """Source points on the original for the texels of one image.

    Attributes
    ----------
    is_filled : (h, w) bool, texels of charts and a border of one texel around each.
    placed : triangles of the original in the atlas.
    placed_indices : (h, w) int32, index into `placed` for each texel; −1 for gaps and for texels in
        `update_planes`.
    looked_up : source points of the texels that no triangle in `placed` covers.
    turned_count : texels whose nearest point faced away and was replaced by a point that faces the same way.
    """

    is_filled: NDArray[np.bool_]
    placed: PlacedTriangles
    placed_indices: NDArray[np.int32]
    looked_up: TexelPoints
    turned_count: int

    @cached_property
    def points(self) -> TexelPoints:
        """Source points of all texels of charts."""
        texels = np.flatnonzero(self.placed_indices >= 0)
        entries = self.placed_indices.reshape(-1)[texels]
        weights = _locate_in_triangles(self.placed.corners, entries, texels, self.placed_indices.shape[1])
        triangles = self.placed.triangles.astype(np.int32)[entries]
        more = self.looked_up
        return TexelPoints(
            np.concatenate([texels, more.texels]),
            np.concatenate([triangles, more.triangles]),
            np.concatenate([weights, more.weights]),
        )

    def sample(
        self,
        canvas: Pixels,
        image: Pixels,
        uvs: NDArray[np.float64],
        is_shown: NDArray[np.bool_],
        wrap: tuple[str, str],
    ) -> None:
        """Sample an image into the texels of a canvas, in place.

        Parameters
        ----------
        canvas : (h, w, c) uint8.
        image : (h', w', c) uint8, image of the original.
        uvs : (m, 3, 2) texture coordinates of the triangles of the original.
        is_shown : (m,) bool, triangles that show the image; texels of other triangles stay unchanged.
        wrap : wrap mode along u and v.
        """
        placed = self.placed
        _kernels.sample_texels(
            canvas,
            self.placed_indices,
            placed.corners,
            uvs[placed.triangles],
            is_shown[placed.triangles],
            np.ascontiguousarray(image),
            wrap=wrap,
            wanted_threads=0,
        )
        points = self.looked_up[is_shown[self.looked_up.triangles]]
        if len(points.texels):
            at = np.einsum("kc,kcx->kx", points.weights, uvs[points.triangles])
            channels = canvas.shape[2]
            canvas.reshape(-1, channels)[points.texels] = _sample_image(image, at, wrap, channels)


@dataclass(frozen=True, eq=False)
class PlacedTriangles:
    """Triangles of the original in the atlas, in drawing order.

    Attributes
    ----------
    corners : (k, 3, 2) float64, texels.
    triangles : (k,) index of the triangle in the original.
    charts, pages : (k,) int32, chart and image of the simplified mesh.
    max_distances : (k,) maximum distance of a texel from its source point, metres; infinite for triangles
        whose normals agree with the chart.
    """

    corners: Floats
    triangles: NDArray[np.int64]
    charts: NDArray[np.int32]
    pages: NDArray[np.int32]
    max_distances: Floats

    def select(self, rows: NDArray[np.intp]) -> PlacedTriangles:
        """Return the triangles with the given indices."""
        return PlacedTriangles(
            self.corners[rows],
            self.triangles[rows],
            self.charts[rows],
            self.pages[rows],
            self.max_distances[rows],
        )


class Correspondence:
    """Lookup of original surface points for the texels of a simplified mesh.

    Parameters
    ----------
    simplified, original : meshes.
    pages : atlas of the simplified mesh.
    vertices : result of `locate_vertices`.
    """

    def __init__(
        self, simplified: Mesh, original: Mesh, pages: AtlasLayout, vertices: VertexLocations
    ) -> None:
        self._simplified, self._original, self._pages = simplified, original, pages
        self._normals = compute_triangle_normals(simplified)
        self._texel_size = pages.compute_mean_texel_size(simplified)
        self._placed = self._place_triangles(vertices)
        self._images: dict[int, NDArray[np.int32]] = {}

    def find_sources(self, page: int) -> TexelSources:
        """Find the source point on the original for each texel of an image."""
        width, height = self._pages.sizes[page]
        mesh, original, pages = self._simplified, self._original, self._pages
        placed = self._placed.select(np.flatnonzero(self._placed.pages == page))
        rows = np.flatnonzero(pages.pages == page)
        image, drawn = _kernels.draw_sources(
            (pages.corners[rows], pages.charts[rows], mesh.vertices[mesh.triangles[rows]]),
            (placed.corners, placed.charts, original.vertices[original.triangles[placed.triangles]]),
            placed.max_distances,
            width=width,
            height=height,
            wanted_threads=0,
        )
        self._images[page] = image
        is_filled = image >= 0
        missing = np.flatnonzero(is_filled & (drawn < 0))
        found, weights, turned_count = [np.zeros(0, np.int32)], [np.zeros((0, 3), np.float32)], 0
        for start in range(0, len(missing), _BATCH_TEXELS):
            own = self.locate_texels(page, missing[start : start + _BATCH_TEXELS])
            some, some_weights, is_turned = self._look_up(own)
            found.append(some)
            weights.append(some_weights.astype(np.float32))
            turned_count += int(np.count_nonzero(is_turned))
        looked_up = TexelPoints(missing, np.concatenate(found), np.concatenate(weights))
        return TexelSources(is_filled, placed, drawn, looked_up, turned_count)

    def locate_texels(self, page: int, texels: NDArray[np.int64]) -> TexelPoints:
        """Locate texels on the simplified mesh; requires `find_sources` for the same page.

        A texel outside all charts gets the nearest point on the border of its chart.
        """
        rows = np.flatnonzero(self._pages.pages == page).astype(np.int32)
        triangles = rows[self._images[page].reshape(-1)[texels]]
        weights = _locate_in_triangles(self._pages.corners, triangles, texels, self._pages.sizes[page][0])
        return TexelPoints(texels, triangles, weights)

    def _look_up(self, own: TexelPoints) -> tuple[NDArray[np.int32], Floats, NDArray[np.bool_]]:
        """Find the nearest points of the original that face the same way.

        Returns
        -------
        Triangles (k,) of the original, barycentric weights (k, 3), and a mask (k,) of points for which a
        nearer point was rejected because it faced away.
        """
        mesh = self._simplified
        a, b, c = (
            mesh.vertices.take(corner, axis=0) for corner in mesh.triangles.take(own.triangles, axis=0).T
        )
        u, v, w = own.weights.astype(np.float64).T[:, :, None]
        points = move_inwards(u * a + v * b + w * c, (a + b + c) / 3, INWARD_OFFSET_TEXELS * self._texel_size)
        surface, reach = self._original_surface
        return surface.find_nearest_facing(
            points, self._normals.take(own.triangles, axis=0), reach=reach, wanted_threads=0
        )

    @cached_property
    def _original_surface(self) -> tuple[_kernels.NearestSurface, float]:
        """Query structure of the original, and the search radius in metres.

        The radius is twice the maximum distance sampled between both meshes. A thin sheet may be displaced to
        the wrong side of itself by simplification; its right side is not much farther away than that.
        """
        surface = _create_surface(self._original)
        step = math.ceil(len(self._simplified.triangles) / DISTANCE_PROBES)
        middles = self._simplified.vertices[self._simplified.triangles[::step]].mean(axis=1)
        _, _, distances = surface.find_nearest(middles, wanted_threads=0)
        return surface, 2 * float(distances.max())

    def _place_triangles(self, vertices: VertexLocations) -> PlacedTriangles:
        """Place the triangles of the original in the atlas, in drawing order."""
        mesh, pages, located = self._original, self._pages, vertices.nearest
        vertex_charts = np.where(vertices.is_facing, pages.charts[located.triangles], -1)
        at = _interpolate(located.weights, pages.corners[located.triangles])
        normals = compute_triangle_normals(mesh)
        a, b, c = (vertex_charts[corner] for corner in mesh.triangles.T)
        is_usable = (a >= 0) & (b >= 0) & (c >= 0)
        is_whole = is_usable & (a == b) & (b == c)
        crossing = self._place_crossing(
            np.flatnonzero(is_usable & ~is_whole), vertex_charts, located, at, normals
        )
        whole = np.flatnonzero(is_whole)
        corners = mesh.triangles[whole]
        distances = _compute_corner_max(located.distances, corners)
        # Draw the nearest triangles last, so that they overwrite other layers of the original.
        order = np.argsort(-distances, kind="stable")
        whole, corners, distances = whole[order], corners[order], distances[order]
        first = located.triangles[corners[:, 0]]
        own = normals[whole]
        under = self._normals[located.triangles]
        is_doubtful = np.zeros(len(whole), bool)
        for corner in corners.T:
            is_doubtful |= _dot(own, under.take(corner, axis=0)) < _MIN_INSIDE_COSINE
        within = PlacedTriangles(
            at[corners],
            whole,
            vertex_charts[corners[:, 0]],
            pages.pages[first],
            self._limit_distances(distances, is_doubtful),
        )
        parts = [*crossing, within]
        joined = PlacedTriangles(
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in PlacedTriangles.__dataclass_fields__
            )
        )
        return self._remove_distorted(joined, located)

    def _limit_distances(self, distances: Floats, is_doubtful: NDArray[np.bool_]) -> Floats:
        return np.where(is_doubtful, _MAX_DISTANCE_RATIO * (distances + self._texel_size), np.inf)

    def _place_crossing(
        self,
        triangles: NDArray[np.int64],
        vertex_charts: NDArray[np.int32],
        located: ClosestPoints,
        at: Floats,
        normals: Floats,
    ) -> list[PlacedTriangles]:
        """Place chart-crossing triangles in each of their charts, extended beyond the border."""
        mesh, pages, simplified = self._original, self._pages, self._simplified
        corners_of = mesh.triangles[triangles]
        charts = vertex_charts[corners_of]
        distances = _compute_corner_max(located.distances, corners_of)
        placed = []
        for k in range(3):
            # Handle each chart once: skip charts of earlier corners.
            is_new = np.ones(len(triangles), bool)
            for j in range(k):
                is_new &= charts[:, j] != charts[:, k]
            rows = np.flatnonzero(is_new)
            base = located.triangles[corners_of[rows, k]]
            plane = simplified.vertices[simplified.triangles[base]]
            corners = np.empty((len(rows), 3, 2))
            for j in range(3):
                vertices = corners_of[rows, j]
                weights = _project_to_planes(mesh.vertices[vertices], plane)
                extended = _interpolate(weights, pages.corners[base])
                is_in_chart = (charts[rows, j] == charts[rows, k])[:, None]
                corners[:, j] = np.where(is_in_chart, at[vertices], extended)
            is_doubtful = _dot(normals[triangles[rows]], self._normals[base]) < _MIN_CROSSING_COSINE
            placed.append(
                PlacedTriangles(
                    corners,
                    triangles[rows],
                    charts[rows, k].astype(np.int32),
                    pages.pages[base],
                    self._limit_distances(distances[rows], is_doubtful),
                )
            )
        return placed

    def _remove_distorted(self, placed: PlacedTriangles, located: ClosestPoints) -> PlacedTriangles:
        """Remove triangles that fold over or tear in the atlas."""
        mesh = self._original
        spread = compute_signed_areas(placed.corners)
        # Charts may be mirrored, so the sign comes from the chart's own triangles.
        chart_areas = compute_signed_areas(self._pages.corners)
        is_laid = self._pages.charts >= 0
        sign = np.sign(np.bincount(self._pages.charts[is_laid], chart_areas[is_laid]))
        is_sound = spread * sign[placed.charts] > 0
        corners = mesh.triangles[placed.triangles]
        distance_texels = _compute_corner_max(located.distances, corners) / self._texel_size
        for start, end in ((0, 1), (1, 2), (2, 0)):
            edge = mesh.vertices.take(corners[:, end], axis=0) - mesh.vertices.take(corners[:, start], axis=0)
            atlas_edge = placed.corners[:, end] - placed.corners[:, start]
            allowed = (
                _MAX_STRETCH * np.sqrt(_dot(edge, edge)) / self._texel_size
                + _STRETCH_TOLERANCE_TEXELS
                + distance_texels
            )
            # Written as <= so that non-finite lengths are removed as well.
            is_sound &= np.sqrt(_dot(atlas_edge, atlas_edge)) <= allowed
        return placed.select(np.flatnonzero(is_sound))


def locate_vertices(simplified: Mesh, original: Mesh) -> VertexLocations:
    """Project original vertices to the simplified mesh, and compare normals."""
    sets, first = find_equal_positions(original.vertices)
    triangles, weights, distances = _create_surface(simplified).find_nearest(
        original.vertices[first], wanted_threads=0
    )
    normals = _sum_normals(original, sets)
    is_facing = _dot(normals, compute_triangle_normals(simplified)[triangles]) > 0
    located = ClosestPoints(triangles.astype(np.int64)[sets], weights[sets], distances[sets])
    return VertexLocations(located, is_facing[sets])


def _create_surface(mesh: Mesh) -> _kernels.NearestSurface:
    return _kernels.NearestSurface(mesh.vertices, mesh.triangles, wanted_threads=0)


def _sum_normals(mesh: Mesh, sets: NDArray[np.int32]) -> Floats:
    """Sum the area-weighted triangle normals of each set of coincident vertices."""
    a, b, c = (mesh.vertices.take(corner, axis=0) for corner in mesh.triangles.T)
    across = np.cross(b - a, c - a)
    at = sets[mesh.triangles].T.reshape(-1)
    count = int(sets.max(initial=-1)) + 1
    sums: Floats = np.stack(
        [np.bincount(at, np.tile(across[:, axis], 3), minlength=count) for axis in range(3)], axis=1
    )
    return sums


def _locate_in_triangles(
    corners: Floats, triangles: NDArray[np.int32], texels: NDArray[np.int64], width: int
) -> NDArray[np.float32]:
    """Return barycentric weights (n, 3) of the triangle points nearest to texels (n,).

    Parameters
    ----------
    corners : (m, 3, 2) triangles of the atlas, texels.
    triangles : (n,) triangle of each texel.
    texels : (n,) row × width + column.
    """
    return _kernels.locate_texels(corners, triangles, texels, width=width, wanted_threads=0)


def _sample_image(image: Pixels, uvs: Floats, wrap: tuple[str, str], channels: int) -> Pixels:
    """Sample an image (h, w, c) at texture coordinates (k, 2), v up.

    Returns
    -------
    (k, channels) uint8.
    """
    return _kernels.sample_points(
        np.ascontiguousarray(image),
        np.ascontiguousarray(uvs, np.float64),
        channels=channels,
        wrap=wrap,
        wanted_threads=0,
    )


def _compute_corner_max(values: Floats, triangles: NDArray[np.int32]) -> Floats:
    """Return the maximum of the corner values of each triangle."""
    a, b, c = (values.take(corner) for corner in triangles.T)
    return np.asarray(np.maximum(np.maximum(a, b), c))


def _interpolate(weights: Floats, corners: Floats) -> Floats:
    """Interpolate the corners (k, 3, d) of triangles."""
    found = weights[:, :1] * corners[:, 0]
    for k in (1, 2):
        found += weights[:, k : k + 1] * corners[:, k]
    return np.asarray(found)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + (a[:, 2] * b[:, 2] if a.shape[1] == 3 else 0.0))


def _project_to_planes(points: Floats, corners: Floats) -> Floats:
    """Project points to triangle planes and return barycentric weights (k, 3)."""
    a = corners[:, 0]
    ab, ac, ap = corners[:, 1] - a, corners[:, 2] - a, points - a
    normal = np.cross(ab, ac)
    squared = np.einsum("kx,kx->k", normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        v = np.einsum("kx,kx->k", np.cross(ap, ac), normal) / squared
        w = np.einsum("kx,kx->k", np.cross(ab, ap), normal) / squared
    return np.stack([1 - v - w, v, w], axis=1)
