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

from scanloom.stages.comparing.asked import Levels, Nearest, Points, asked, corners_of
from scanloom.stages.comparing.compare import (
    CompareParams,
    Comparison,
    all_sums,
    comparison_of,
    one_way,
    sums_of,
)
from scanloom.stages.comparing.deviations import DeviationParams, Deviations, Found, deviations_of, points_of
from scanloom.stages.comparing.needles import WithNeedles
from scanloom.stages.comparing.sampling import drawn, located, share_of
from scanloom.stages.comparing.signed import Sides, sides_of
from scanloom.stages.surface.color import color_at, has_color
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.piecewise import Piece, Piecewise
from scanloom.stages.surface.raycasting import Floats, Located, Surface, chunks, interpolated

Mask = NDArray[np.bool_]

# Relative tolerance for rounding: distance bounds are enlarged by it, and positions closer than this ratio of
# the box diagonal count as equal.
_SLACK = 1e-9


def compare_in_pieces(
    large: Piecewise,
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
    large : chunked mesh A.
    mesh : mesh B.
    params : sampling density and seed.
    box : (2, 3) bounding box of all meshes, metres.
    signed : a mesh and parameters if signed deviations from A are also wanted, as from `deviations`.

    Returns
    -------
    The comparison, and the deviations of the mesh in `signed` (None without it).

    Raises
    ------
    InputError
        If the file of the chunked mesh is damaged.
    """
    # `light` builds its search structure only on first use, after all chunks are done; memory does not hold
    # both.
    light = asked(mesh, box)
    colored = large.has_colors and light.has_color
    rng, count = np.random.default_rng((params.seed, 1)), params.samples
    samples = [light.spread(rows, count, rng, colored=colored) for rows in chunks(count)]
    corners = list(light.corners(colored=colored))
    points = [*samples, *corners]
    question = _Question(np.concatenate([one.places for one in points]), large, colored=colored)
    off = None if signed is None else _Off(*signed, large, box)
    for piece in large.pieces():
        one = _Asked(piece, box)
        question.ask(one)
        if off is not None:
            off.question.ask(one)
    sums = [
        sums_of(one.colors, question.nearest(rows))
        for one, rows in zip(points, _rows_of(points), strict=True)
    ]
    backward = all_sums(colored, sums[: len(samples)], sums[len(samples) :])
    deviating = None if off is None else off.deviations()
    # Free the points first: the reverse direction needs the memory for the search structure of `light`.
    del samples, corners, points, question, off
    forward = one_way(_InPieces(large), light, params.samples, (params.seed, 0))
    return comparison_of(forward, backward, large.box, params.samples), deviating


def _rows_of(points: list[Points]) -> Iterator[slice]:
    ends = np.cumsum([0, *(len(one.places) for one in points)])
    return (slice(first, end) for first, end in pairwise(ends.tolist()))


class _InPieces:
    """Sampled surface of a chunked mesh.

    The sample points are the same as for a mesh in memory.
    """

    def __init__(self, large: Piecewise) -> None:
        self._large = large

    @property
    def has_color(self) -> bool:
        return self._large.has_colors

    def samples(self, wanted: int) -> int:
        return wanted

    def spread(self, rows: slice, count: int, rng: np.random.Generator, *, colored: bool) -> Points:
        ends = self._large.area_ends
        before, weights = drawn(float(ends[-1]), rows, count, rng)
        piece = share_of(ends, before)
        found = []
        for number in np.unique(piece).tolist():
            chosen, mesh = piece == number, self._large.mesh(number)
            at = located(self._large.areas_up_to(number, mesh)[1:], before[chosen], weights[chosen])
            colors = color_at(mesh, at.triangles, at.weights) if colored else None
            found.append(Points(interpolated(mesh.vertices, mesh, at), colors))
        seen = [one.colors for one in found if one.colors is not None]
        places = np.concatenate([one.places for one in found])
        return Points(places, np.concatenate(seen) if seen else None)

    def corners(self, *, colored: bool) -> Iterator[Points]:
        for number in range(len(self._large)):
            yield from corners_of(self._large.mesh(number), colored=colored)


class _Asked:
    """Batch of triangles with search structures built on first use.

    Attributes
    ----------
    mesh, box : triangles of the batch and their bounding box (2, 3).
    """

    def __init__(self, piece: Piece, box: Floats) -> None:
        self.mesh, self.box = piece.mesh, piece.box
        self._all = box

    @cached_property
    def searched(self) -> WithNeedles:
        return WithNeedles(Surface(self.mesh, self._all), self._all)

    @cached_property
    def sides(self) -> Sides | None:
        return sides_of(self.mesh)


class _Question:
    """Nearest points to query points (k, 3), updated batch by batch."""

    def __init__(self, points: Floats, large: Piecewise, *, colored: bool, signed: bool = False) -> None:
        self._points, self._signed = points, signed
        self._enough = large.at_most(points) * (1 + _SLACK)
        self._distances = np.full(len(points), np.inf)
        self._colors: Levels | None = np.zeros((len(points), 3)) if colored else None
        # For signs: height above the surface at the nearest point, and the position of that point.
        self._heights = np.zeros(len(points) if signed else 0)
        self._places = np.full((len(points) if signed else 0, 3), np.inf)
        self._one_place = _SLACK * float(np.linalg.norm(large.box[1] - large.box[0]))
        self.has_sides = signed

    def ask(self, piece: _Asked) -> None:
        low, high = piece.box
        # One coordinate at a time: several times faster than rows of three.
        squared = np.zeros(len(self._points))
        for axis, x in enumerate(self._points.T):
            away = np.maximum(low[axis] - x, x - high[axis]).clip(0)
            squared += away * away
        rows = np.flatnonzero(np.sqrt(squared) <= self._enough)
        if not len(rows):
            return
        found = piece.searched.closest(self._points[rows])
        is_nearer = found.distances < self._distances[rows]
        if self._signed:
            self._look(piece, rows, found, is_nearer)
        nearer = rows[is_nearer]
        self._distances[nearer] = found.distances[is_nearer]
        self._enough[nearer] = np.minimum(self._enough[nearer], self._distances[nearer] * (1 + _SLACK))
        if self._colors is not None:
            self._colors[nearer] = color_at(piece.mesh, found.triangles[is_nearer], found.weights[is_nearer])

    def _look(self, piece: _Asked, rows: NDArray[np.intp], found: Located, is_nearer: Mask) -> None:
        """Update the signed heights of the query points.

        Where batches meet at the nearest point, their pseudonormal contributions add up.
        """
        if piece.sides is None:
            self.has_sides = False
            return
        places = interpolated(piece.mesh.vertices, piece.mesh, found)
        heights = piece.sides.heights(self._points[rows], found)
        is_same = (np.abs(places - self._places[rows]) <= self._one_place).all(axis=1)
        self._heights[rows[is_same]] += heights[is_same]
        is_other = is_nearer & ~is_same
        self._heights[rows[is_other]] = heights[is_other]
        self._places[rows[is_other]] = places[is_other]

    def nearest(self, rows: slice) -> Nearest:
        """Return the nearest points found so far.

        Distances are signed if requested and if every batch has pseudonormals.
        """
        distances = self._distances[rows]
        if self.has_sides:
            distances = np.where(self._heights[rows] < 0, -distances, distances)
        return Nearest(distances, None if self._colors is None else self._colors[rows])


class _Off:
    """Signed deviations of a mesh from a chunked mesh."""

    def __init__(self, measured: Mesh, params: DeviationParams, large: Piecewise, box: Floats) -> None:
        self._measured, self._params = measured, params
        colored = large.has_colors and has_color(measured)
        self._points = points_of(asked(measured, box), params, colored=colored)
        self._used = np.unique(measured.triangles)
        places = np.concatenate([self._points.places, measured.vertices[self._used]])
        self.question = _Question(places, large, colored=colored, signed=True)

    def deviations(self) -> Deviations:
        count = len(self._points.places)
        samples = self.question.nearest(slice(0, count))
        at_vertices = np.zeros(len(self._measured.vertices))
        at_vertices[self._used] = self.question.nearest(slice(count, None)).distances
        found = Found(self.question.has_sides, None, samples.distances, samples.colors, at_vertices)
        return deviations_of(self._measured, self._points, found, self._params)
