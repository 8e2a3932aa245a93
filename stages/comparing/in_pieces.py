"""How far apart a mesh in pieces and another one are, which alone has room in memory.

The same points are drawn as of the whole mesh. From the pieces to the other mesh they are measured piece by
piece; the other way, each piece in turn is asked for what of it is nearest, by those points that no piece so
far, nor any vertex of the mesh, is nearer to than its box.
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

# For rounding: a box counts as this much nearer than it is, and places as near as this share of the mesh's
# size are one.
_SLACK = 1e-9


def compare_in_pieces(
    large: Piecewise,
    mesh: Mesh,
    params: CompareParams,
    *,
    box: Floats,
    signed: tuple[Mesh, DeviationParams] | None = None,
) -> tuple[Comparison, Deviations | None]:
    """Measure the two-sided distance of a mesh in pieces, A, and another one, B, as `compare` does.

    Memory holds one piece at a time, and some 100 bytes for each sample.

    Parameters
    ----------
    box : (2, 3) around all meshes.
    signed : a mesh whose deviations from A are wanted, too, as `deviations` tells them.

    Raises
    ------
    InputError
        If the file of the pieces is damaged.
    """
    # It is made ready to be searched when no piece is any more: there is no room for both.
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
    # The other way, the mesh is searched, which takes the room that its points had.
    del samples, corners, points, question, off
    forward = one_way(_InPieces(large), light, params.samples, (params.seed, 0))
    return comparison_of(forward, backward, large.box, params.samples), deviating


def _rows_of(points: list[Points]) -> Iterator[slice]:
    ends = np.cumsum([0, *(len(one.places) for one in points)])
    return (slice(first, end) for first, end in pairwise(ends.tolist()))


class _InPieces:
    """A mesh in pieces, of which points are spread as of the whole."""

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
    """A piece that is made ready as far as it is asked.

    Attributes
    ----------
    mesh, box : of the piece.
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
    """What is nearest to some points (k, 3), of the pieces that were asked so far."""

    def __init__(self, points: Floats, large: Piecewise, *, colored: bool, signed: bool = False) -> None:
        self._points, self._signed = points, signed
        self._enough = large.at_most(points) * (1 + _SLACK)
        self._distances = np.full(len(points), np.inf)
        self._colors: Levels | None = np.zeros((len(points), 3)) if colored else None
        # For signs: how high points are there, and where that is.
        self._heights = np.zeros(len(points) if signed else 0)
        self._places = np.full((len(points) if signed else 0, 3), np.inf)
        self._one_place = _SLACK * float(np.linalg.norm(large.box[1] - large.box[0]))
        self.has_sides = signed

    def ask(self, piece: _Asked) -> None:
        low, high = piece.box
        # A coordinate at a time: several times as fast as rows of three.
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
        """Keep on which side points are: where pieces meet, what all of them say together counts."""
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
        """Return what was found, with signs if these were asked for and all pieces have sides."""
        distances = self._distances[rows]
        if self.has_sides:
            distances = np.where(self._heights[rows] < 0, -distances, distances)
        return Nearest(distances, None if self._colors is None else self._colors[rows])


class _Off:
    """How far a mesh is off a mesh in pieces."""

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
