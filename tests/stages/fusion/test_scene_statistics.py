"""Depth noise fitted to the differences between neighbouring frames."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from scanloom.stages.fusion.scene_statistics import _fit_two_terms


@pytest.mark.parametrize("seed", range(40))
def test_two_terms_are_fitted_like_scipy(seed: int) -> None:
    draw = np.random.default_rng(seed)
    terms = draw.random((8, 2)) * draw.choice([0.01, 1, 10], 2)
    # All cases of active constraints: both terms positive, either one, none.
    values = terms @ np.array([[1, 2], [1, -0.7], [-0.7, 1], [-1, -1]][seed % 4]) + 0.05 * draw.random(8)
    assert _fit_two_terms(terms, values) == pytest.approx(tuple(nnls(terms, values)[0]), abs=1e-9)


def test_a_single_depth_determines_one_term() -> None:
    terms = np.ones((3, 2))
    assert _fit_two_terms(terms, np.full(3, 0.5)) == pytest.approx((0.5, 0))
    assert _fit_two_terms(np.zeros((3, 2)), np.zeros(3)) == (0, 0)
