"""Minimum-area triangulations, compared with all triangulations of a loop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from scanloom.stages.surface.edges import make_edge_keys
from scanloom.stages.surface.loop_triangulation import triangulate_loops
from scanloom.stages.surface.topology import compute_areas


def _list_triangulations(first: int, last: int) -> Iterator[list[tuple[int, int, int]]]:
    """Yield all triangulations of a chain of vertices whose ends are joined by an edge."""
    if last - first < 2:
        yield []
        return
    for middle in range(first + 1, last):
        for left in _list_triangulations(first, middle):
            for right in _list_triangulations(middle, last):
                yield [(first, middle, last), *left, *right]


def _find_smallest(points: np.ndarray, loop: np.ndarray, existing: set[tuple[int, int]]) -> float:
    """Find the minimum area of triangulations without existing edges, or infinity."""
    count = len(loop)
    sides = {tuple(sorted((k, (k + 1) % count))) for k in range(count)}
    areas = [np.inf]
    for triangles in _list_triangulations(0, count - 1):
        edges = {tuple(sorted(pair)) for a, b, c in triangles for pair in ((a, b), (b, c), (c, a))} - sides
        if not any(tuple(sorted((int(loop[a]), int(loop[b])))) in existing for a, b in edges):
            areas.append(compute_areas(points, loop[np.array(triangles)]).sum())
    return min(areas)


@pytest.mark.parametrize("seed", range(4))
def test_the_area_is_the_smallest_of_all_triangulations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(60, 3))
    loops = [rng.choice(60, count, replace=False) for count in (3, 7, 4, 5, 7, 4, 6, 8, 4)]
    pairs = {
        (int(min(a, b)), int(max(a, b))) for loop in loops for a, b in rng.choice(loop, (4, 2)) if a != b
    }
    existing = np.sort(make_edge_keys(*np.array(sorted(pairs)).T))
    found = triangulate_loops(points, loops, existing)
    smallest = [_find_smallest(points, loop, pairs) for loop in loops]
    for loop, triangles, area in zip(loops, found, smallest, strict=True):
        if triangles is None:
            assert area == np.inf
            continue
        assert triangles.shape == (len(loop) - 2, 3)
        assert compute_areas(points, loop[triangles]).sum() == pytest.approx(area)
    assert any(one is not None for one in found)


def test_loops_on_a_line_or_without_allowed_chords_have_no_triangulation() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    square = np.array([0, 1, 4, 5])
    none = np.empty(0, np.int64)
    flat_three, flat_four, open_square = triangulate_loops(points, [np.arange(3), np.arange(4), square], none)
    assert flat_three is None
    assert flat_four is None
    assert open_square is not None
    both = np.sort(make_edge_keys(np.array([0, 1]), np.array([4, 5])))
    assert triangulate_loops(points, [square], both) == [None]
    (other,) = triangulate_loops(points, [square], both[:1])
    assert other is not None
    assert not {0, 2} <= set(other[0].tolist()) & set(other[1].tolist())
    assert triangulate_loops(points, [], none) == []
