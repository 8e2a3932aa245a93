"""Minimum-area triangulation of closed loops.

Source: Barequet and Sharir, "Filling gaps in the boundary of a polyhedron", 1995: dynamic programming over
chains of the loop. Loops of equal length are processed together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Ids, is_known_key, make_edge_keys
from scanloom.stages.surface.mesh import Triangles, Vertices
from scanloom.stages.surface.topology import MAX_FLATNESS

# Vertex pairs of loops that are processed together: limits memory.
_MAX_PAIRS = 200_000


def triangulate_loops(points: Vertices, loops: Sequence[Ids], existing: Ids) -> list[Triangles | None]:
    """Compute the minimum-area triangulation of each loop.

    Parameters
    ----------
    points : (n, 3) positions, metres.
    loops : (k,) vertices of each loop, at least three.
    existing : edge keys, ascending, that cannot become an edge; edges of the loops are excepted.

    Returns
    -------
    Triangles (k − 2, 3) as positions in the loop; None for a loop without such a triangulation.
    """
    found: list[Triangles | None] = [None] * len(loops)
    for numbers in _group_by_length(loops):
        group = np.stack([loops[number] for number in numbers])
        coordinates = np.ascontiguousarray(points[group].transpose(2, 0, 1))
        if group.shape[1] == 3:
            parts = _keep_triangles(coordinates)
        else:
            parts = _triangulate_group(coordinates, _find_allowed_chords(group, existing))
        for number, part in zip(numbers, parts, strict=True):
            found[number] = part
    return found


def _group_by_length(loops: Sequence[Ids]) -> Iterator[list[int]]:
    """Yield indices of loops of equal length, few enough for the memory."""
    lengths = np.array([len(loop) for loop in loops], np.int64)
    for length in np.unique(lengths).tolist():
        numbers = np.flatnonzero(lengths == length).tolist()
        size = max(_MAX_PAIRS // length**2, 1)
        for start in range(0, len(numbers), size):
            yield numbers[start : start + size]


def _keep_triangles(coordinates: NDArray[np.float64]) -> list[Triangles | None]:
    areas = _compute_doubled_areas(*(coordinates[:, :, corner] for corner in range(3)))
    return [None if np.isinf(area) else np.array([[0, 1, 2]], np.int32) for area in areas]


def _find_allowed_chords(loops: Ids, existing: Ids) -> NDArray[np.bool_]:
    """Return a mask (g, k, k) of the vertex pairs (i, j), i + 2 ≤ j, of loops (g, k) that can be an edge."""
    count = loops.shape[1]
    allowed = np.ones((len(loops), count, count), bool)
    i, j = np.triu_indices(count, 2)
    allowed[:, i, j] = ~is_known_key(make_edge_keys(loops[:, i], loops[:, j]), existing)
    # The first and the last vertex have an edge of the loop.
    allowed[:, 0, -1] = True
    return allowed


def _triangulate_group(
    coordinates: NDArray[np.float64], allowed: NDArray[np.bool_]
) -> list[Triangles | None]:
    """Triangulate loops of equal length.

    Parameters
    ----------
    coordinates : (3, g, k) metres.
    allowed : (g, k, k) vertex pairs that can become an edge.
    """
    group, count = coordinates.shape[1:]
    cost = np.full((group, count, count), np.inf)
    middle = np.zeros((group, count, count), np.int64)
    cost[:, np.arange(count - 1), np.arange(1, count)] = 0
    for gap in range(2, count):
        i = np.arange(count - gap)[:, None]
        j = i + gap
        k = i + np.arange(1, gap)
        total = cost[:, i, k] + cost[:, k, j]
        total += _compute_doubled_areas(*(coordinates[:, :, one] for one in (i, k, j)))
        best = total.argmin(axis=2)
        first, last = i[:, 0], j[:, 0]
        smallest = np.take_along_axis(total, best[:, :, None], axis=2)[:, :, 0]
        cost[:, first, last] = np.where(allowed[:, first, last], smallest, np.inf)
        middle[:, first, last] = first + 1 + best
    is_possible = np.isfinite(cost[:, 0, -1])
    return [
        _collect_triangles(one) if possible else None
        for one, possible in zip(middle, is_possible, strict=True)
    ]


def _collect_triangles(middle: Ids) -> Triangles:
    """Return the triangles (k − 2, 3) of a loop.

    Parameters
    ----------
    middle : (k, k) third vertex of the triangle at the chord between two vertices.
    """
    triangles = []
    rows = middle.tolist()
    open_chains = [(0, len(rows) - 1)]
    while open_chains:
        first, last = open_chains.pop()
        if last - first < 2:
            continue
        between = rows[first][last]
        triangles.append((first, between, last))
        open_chains += [(first, between), (between, last)]
    return np.array(triangles, np.int32)


def _compute_doubled_areas(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return twice the areas (…) of triangles with corners (3, …).

    The area of degenerate triangles is infinite, which excludes them.
    """
    ab, ac, bc = b - a, c - a, c - b
    normal = [ab[p] * ac[q] - ab[q] * ac[p] for p, q in ((1, 2), (2, 0), (0, 1))]
    doubled = np.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    squares = [x * x + y * y + z * z for x, y, z in (ab, ac, bc)]
    longest = np.maximum(np.maximum(squares[0], squares[1]), squares[2])
    return np.where(doubled <= MAX_FLATNESS * longest, np.inf, doubled)
