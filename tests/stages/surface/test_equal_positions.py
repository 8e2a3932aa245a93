"""Sets of vertices at equal positions, and their keys."""

from __future__ import annotations

import itertools

import numpy as np

from scanloom.stages.surface.equal_positions import find_equal_positions, hash_positions


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
