"""Even sampling: at most the requested number of indices, unique, from the first item to the last."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from scanloom.stages.frames.sampling import sample_evenly


@given(count=st.integers(1, 5000), max_count=st.integers(2, 300))
def test_indices_are_spread_evenly(count: int, max_count: int) -> None:
    indices = sample_evenly(count, max_count)
    assert len(indices) == min(count, max_count)
    assert indices[0] == 0
    assert indices[-1] == count - 1
    steps = np.diff(indices)
    if len(steps):
        assert steps.min() >= 1
        # Rounding moves each end of a step by up to half an item.
        assert np.ptp(steps) <= 2


def test_few_items_are_all_taken() -> None:
    assert sample_evenly(3, 10).tolist() == [0, 1, 2]
    assert sample_evenly(1, 10).tolist() == [0]
    assert sample_evenly(0, 10).tolist() == []
