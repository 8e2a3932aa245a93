"""Merge forest: when two vertices become one, compared with following each of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.simplification.records.merge_forest import MergeForest


def follow_merges(count: int, removed: list[int], survivor: list[int], a: int, b: int) -> int:
    """Find the first collapse after which both vertices are part of the same vertex."""
    part = list(range(count))
    if a != b:
        for number, (gone, into) in enumerate(zip(removed, survivor, strict=True)):
            part = [into if p == gone else p for p in part]
            if part[a] == part[b]:
                return number
    return len(removed)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_any_forest_agrees_with_following(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 24))
    order = rng.permutation(count)
    steps = int(rng.integers(0, count))
    removed = order[:steps]
    # Into any remaining vertex or, for tall trees, into the next one to be removed.
    tall = rng.random() < 0.5
    ends = [i + 1 if tall and rng.random() < 0.8 else int(rng.integers(i + 1, count)) for i in range(steps)]
    survivor = order[ends] if steps else order[:0]
    a, b = (side.reshape(-1) for side in np.meshgrid(np.arange(count), np.arange(count)))
    met = MergeForest(count, removed.astype(np.int32), survivor.astype(np.int32)).find_merges(a, b)
    there, into = removed.tolist(), survivor.tolist()
    assert met.tolist() == [
        follow_merges(count, there, into, *pair) for pair in zip(a.tolist(), b.tolist(), strict=True)
    ]


@pytest.mark.parametrize("height", [1, 2, 3, 4, 5, 8, 9, 1000, 200_000])
def test_a_chain_is_searched_in_short_time(height: int) -> None:
    """Every vertex collapses into the next; following them takes as many steps as there are vertices."""
    steps = np.arange(height, dtype=np.int32)
    meetings = MergeForest(height + 1, steps, steps + 1)
    vertices = np.arange(height + 1, dtype=np.int32)
    np.testing.assert_array_equal(meetings.find_merges(vertices[:-1], vertices[1:]), steps)
    np.testing.assert_array_equal(meetings.find_merges(np.zeros(height, np.int32), vertices[1:]), steps)


def test_without_collapses_only_equal_vertices_are_merged() -> None:
    none = np.zeros(0, np.int32)
    meetings = MergeForest(3, none, none)
    assert meetings.find_merges(np.array([0, 1], np.int32), np.array([1, 1], np.int32)).tolist() == [0, 0]
