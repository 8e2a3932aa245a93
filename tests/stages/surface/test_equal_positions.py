"""Sets of vertices at equal positions, and their keys."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from scanloom.stages.surface.equal_positions import find_equal_positions, hash_positions, rank_labels


def test_mirrored_and_permuted_positions_have_different_keys() -> None:
    random = np.random.default_rng(0)
    one = random.random((200, 3))
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    positions = np.concatenate([(one * sign)[:, order] for sign in signs for order in ([0, 1, 2], [2, 0, 1])])
    assert len(np.unique(hash_positions(positions))) == len(positions)


def test_equal_positions_form_sets_in_the_order_of_their_first_vertices() -> None:
    positions = np.array([[1, 2, 3], [0.0, 0, 0], [1, 2, 3], [-0.0, 0, -0.0], [3, 2, 1]])
    sets, first = find_equal_positions(positions)
    assert sets.tolist() == [0, 1, 0, 1, 2]
    assert first.tolist() == [0, 1, 4]


@pytest.mark.parametrize("repeated", [0, 3, 40, 900])
def test_few_and_many_equal_positions_give_the_sets_of_numpy(repeated: int) -> None:
    random = np.random.default_rng(repeated)
    vertices = random.random((1000, 3))
    vertices[random.permutation(1000)[:repeated]] = random.random((1 + repeated // 3, 3))[
        random.integers(0, 1 + repeated // 3, repeated)
    ]
    expected = rank_labels(np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1))

    sets, first = find_equal_positions(vertices)

    np.testing.assert_array_equal(sets, expected)
    np.testing.assert_array_equal(vertices[first][sets], vertices)
