"""Comparison of a chunked mesh larger than memory with another mesh.

Samples are identical to those for a mesh in memory. Distances from the chunked mesh to the other mesh are
measured chunk by chunk. In the other direction, each chunk is queried only for points whose distance bound so
far exceeds the distance to the chunk's box.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.compare import (
    CompareParams,
    Comparison,
    accumulate_one_way,
    combine_directions,
    compute_sums,
    merge_sums,
)
from scanloom.stages.comparing.deviations import (
    DeviationParams,
    Deviations,
    MeasuredDistances,
    draw_measurement_points,
    evaluate_deviations,
)
from scanloom.stages.comparing.distance_target import (
    Levels,
    NearestPoints,
    SamplePoints,
    iterate_used_vertices,
    make_distance_target,
)
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.comparing.signed_distance import Pseudonormals, build_pseudonormals
from scanloom.stages.comparing.surface_sampling import draw_area_offsets, find_intervals, locate_on_triangles
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, TriangleBatch
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import (
    ClosestPoints,
    Floats,
    RaycastingSurface,
    interpolate_values,
    iterate_chunks,
)
from scanloom.stages.surface.surface_color import compute_surface_colors, has_color

Mask = NDArray[np.bool_]

# Relative tolerance for rounding: distance bounds are enlarged by it, and positions closer than this ratio of
# the box diagonal count as equal.
_ROUNDING_RATIO = 1e-9


def compare_chunked(
    chunked_mesh: ChunkedMesh,
    mesh: Mesh,
    params: CompareParams,
    *,
    box: Floats,
    signed: tuple[Mesh, DeviationParams] | None = None,
) -> tuple[Comparison, Deviations | None]:
    """Compare a chunked mesh A with a mesh B, as `compare` does.

    Memory holds one chunk at a time, plus about 100 bytes per sample.

    Parameters
    ----------
    chunked_mesh : chunked mesh A.
    mesh : mesh B.
    params : sampling density and seed.
    box : (2, 3) bounding box of all meshes, metres.
    signed : a mesh and parameters if signed deviations from A are also wanted, as from `evaluate`.

    Returns
    -------
    The comparison, and the deviations of the mesh in `wants_signs` (None without it).

    Raises
    ------
    InputError
        If the file of the chunked mesh is damaged.
    """
    # `light` builds its search structure only on first use, after all chunks are done; memory does not hold
    # both.
    target = make_distance_target(mesh, box)
    colored = chunked_mesh.has_colors and target.has_color
    rng, count = np.random.default_rng((params.seed, 1)), params.samples
    samples = [target.draw_points(rows, count, rng, colored=colored) for rows in iterate_chunks(count)]
    corners = list(target.iterate_extra_points(colored=colored))
    points = [*samples, *corners]
    query = _StreamingNearestQuery(
        np.concatenate([one.positions for one in points]), chunked_mesh, colored=colored
    )
    deviation = None if signed is None else _StreamingDeviation(*signed, chunked_mesh, box)
    for piece in chunked_mesh.iterate_batches():
        one = _SearchableBatch(piece, box)
        query.update(one)
        if deviation is not None:
            deviation.query.update(one)
    sums = [
        compute_sums(one.colors, query.collect_nearest(rows))
        for one, rows in zip(points, _iterate_rows(points), strict=True)
    ]
    backward = merge_sums(colored, sums[: len(samples)], sums[len(samples) :])
    deviations = None if deviation is None else deviation.evaluate()
    # Free the points first: the reverse direction needs the memory for the search structure of `light`.
    del samples, corners, points, query, deviation
    forward = accumulate_one_way(
        _ChunkedSampledSurface(chunked_mesh), target, params.samples, (params.seed, 0)
    )
    return combine_directions(forward, backward, chunked_mesh.box, params.samples), deviations


def _iterate_rows(points: list[SamplePoints]) -> Iterator[slice]:
    ends = np.cumsum([0, *(len(one.positions) for one in points)])
    return (slice(first, end) for first, end in pairwise(ends.tolist()))


class _ChunkedSampledSurface:
    """Sampled surface of a chunked mesh.

    The sample points are the same as for a mesh in memory.
    """

    def __init__(self, chunked_mesh: ChunkedMesh) -> None:
        self._chunked_mesh = chunked_mesh

    @property
    def has_color(self) -> bool:
        return self._chunked_mesh.has_colors

    def count_samples(self, requested: int) -> int:
        return requested

    def draw_points(
        self, rows: slice, count: int, rng: np.random.Generator, *, colored: bool
    ) -> SamplePoints:
        ends = self._chunked_mesh.area_ends
        before, weights = draw_area_offsets(float(ends[-1]), rows, count, rng)
        piece = find_intervals(ends, before)
        found = []
        for number in np.unique(piece).tolist():
            chosen, mesh = piece == number, self._chunked_mesh.read_mesh(number)
            at = locate_on_triangles(
                self._chunked_mesh.accumulate_areas(number, mesh)[1:], before[chosen], weights[chosen]
            )
            colors = compute_surface_colors(mesh, at.triangles, at.weights) if colored else None
            found.append(SamplePoints(interpolate_values(mesh.vertices, mesh, at), colors))
        seen = [one.colors for one in found if one.colors is not None]
        places = np.concatenate([one.positions for one in found])
        return SamplePoints(places, np.concatenate(seen) if seen else None)

    def iterate_extra_points(self, *, colored: bool) -> Iterator[SamplePoints]:
        for number in range(len(self._chunked_mesh)):
            yield from iterate_used_vertices(self._chunked_mesh.read_mesh(number), colored=colored)


class _SearchableBatch:
    """Batch of triangles with search structures built on first use.

    Attributes
    ----------
    mesh, box : triangles of the batch and their bounding box (2, 3).
    """

    def __init__(self, piece: TriangleBatch, box: Floats) -> None:
        self.mesh, self.box = piece.mesh, piece.box
        self._query_box = box

    @cached_property
    def search_surface(self) -> NeedleSafeSurface:
        return NeedleSafeSurface(RaycastingSurface(self.mesh, self._query_box), self._query_box)

    @cached_property
    def pseudonormals(self) -> Pseudonormals | None:
        return build_pseudonormals(self.mesh)


class _StreamingNearestQuery:
    """Nearest points to query points (k, 3), updated batch by batch."""

    def __init__(
        self, points: Floats, chunked_mesh: ChunkedMesh, *, colored: bool, wants_signs: bool = False
    ) -> None:
        self._points, self._wants_signs = points, wants_signs
        self._distance_bounds = chunked_mesh.bound_distances(points) * (1 + _ROUNDING_RATIO)
        self._distances = np.full(len(points), np.inf)
        self._colors: Levels | None = np.zeros((len(points), 3)) if colored else None
        # For signs: height above the surface at the nearest point, and the position of that point.
        self._heights = np.zeros(len(points) if wants_signs else 0)
        self._nearest_positions = np.full((len(points) if wants_signs else 0, 3), np.inf)
        self._position_tolerance = _ROUNDING_RATIO * float(
            np.linalg.norm(chunked_mesh.box[1] - chunked_mesh.box[0])
        )
        self.is_signed = wants_signs

    def update(self, piece: _SearchableBatch) -> None:
        low, high = piece.box
        # One coordinate at a time: several times faster than rows of three.
        squared = np.zeros(len(self._points))
        for axis, x in enumerate(self._points.T):
            away = np.maximum(low[axis] - x, x - high[axis]).clip(0)
            squared += away * away
        rows = np.flatnonzero(np.sqrt(squared) <= self._distance_bounds)
        if not len(rows):
            return
        found = piece.search_surface.find_closest_points(self._points[rows])
        is_nearer = found.distances < self._distances[rows]
        if self._wants_signs:
            self._update_heights(piece, rows, found, is_nearer)
        nearer = rows[is_nearer]
        self._distances[nearer] = found.distances[is_nearer]
        self._distance_bounds[nearer] = np.minimum(
            self._distance_bounds[nearer], self._distances[nearer] * (1 + _ROUNDING_RATIO)
        )
        if self._colors is not None:
            self._colors[nearer] = compute_surface_colors(
                piece.mesh, found.triangles[is_nearer], found.weights[is_nearer]
            )

    def _update_heights(
        self, piece: _SearchableBatch, rows: NDArray[np.intp], nearest: ClosestPoints, is_nearer: Mask
    ) -> None:
        """Update the signed heights of the query points.

        Where batches meet at the nearest point, their pseudonormal contributions add up.
        """
        if piece.pseudonormals is None:
            self.is_signed = False
            return
        places = interpolate_values(piece.mesh.vertices, piece.mesh, nearest)
        heights = piece.pseudonormals.compute_heights(self._points[rows], nearest)
        is_same = (np.abs(places - self._nearest_positions[rows]) <= self._position_tolerance).all(axis=1)
        self._heights[rows[is_same]] += heights[is_same]
        is_other = is_nearer & ~is_same
        self._heights[rows[is_other]] = heights[is_other]
        self._nearest_positions[rows[is_other]] = places[is_other]

    def collect_nearest(self, rows: slice) -> NearestPoints:
        """Return the nearest points found so far.

        Distances are signed if requested and if every batch has pseudonormals.
        """
        distances = self._distances[rows]
        if self.is_signed:
            distances = np.where(self._heights[rows] < 0, -distances, distances)
        return NearestPoints(distances, None if self._colors is None else self._colors[rows])


class _StreamingDeviation:
    """Signed deviations of a mesh from a chunked mesh."""

    def __init__(
        self, measured: Mesh, params: DeviationParams, chunked_mesh: ChunkedMesh, box: Floats
    ) -> None:
        self._measured, self._params = measured, params
        colored = chunked_mesh.has_colors and has_color(measured)
        self._points = draw_measurement_points(make_distance_target(measured, box), params, colored=colored)
        self._used_vertices = np.unique(measured.triangles)
        places = np.concatenate([self._points.positions, measured.vertices[self._used_vertices]])
        self.query = _StreamingNearestQuery(places, chunked_mesh, colored=colored, wants_signs=True)

    def evaluate(self) -> Deviations:
        count = len(self._points.positions)
        samples = self.query.collect_nearest(slice(0, count))
        at_vertices = np.zeros(len(self._measured.vertices))
        at_vertices[self._used_vertices] = self.query.collect_nearest(slice(count, None)).distances
        found = MeasuredDistances(self.query.is_signed, None, samples.distances, samples.colors, at_vertices)
        return evaluate_deviations(self._measured, self._points, found, self._params)
