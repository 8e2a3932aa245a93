"""Pairs of close vertices found by sorting are equal to pairs found by a tree."""

import numpy as np
import pytest

from scanloom.stages.simplification.seams.similar_vertices import _find_pairs_by_sorting, _find_pairs_by_tree


@pytest.mark.parametrize("seed", range(40))
def test_pairs_found_by_sorting_equal_those_of_a_tree(seed):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.integers(-3, 4)
    places = rng.normal(size=(rng.integers(2, 800), 3)) * scale
    if seed % 3 == 0:
        # Points on a grid, as in a height field.
        places = np.round(places / scale * 4) * scale / 4
    distance = scale * 10.0 ** rng.integers(-9, -2)
    copied = rng.integers(0, len(places), len(places) // 3)
    copies = places[copied] + rng.normal(size=(len(copied), 3)) * 0.6 * distance
    places = np.unique(np.vstack([places, copies]), axis=0) + (seed % 5) * 30 * scale
    places = np.unique(places, axis=0)[rng.permutation(len(np.unique(places, axis=0)))]

    found = _find_pairs_by_sorting(places, distance)

    assert found is not None
    assert make_unordered(found) == make_unordered(_find_pairs_by_tree(places, distance))


def test_sorting_is_refused_if_all_vertices_are_close():
    assert _find_pairs_by_sorting(np.random.default_rng(1).normal(size=(100, 3)) * 1e-3, 1.0) is None


def make_unordered(pairs: np.ndarray) -> set[frozenset[int]]:
    return {frozenset(pair) for pair in pairs.tolist()}
