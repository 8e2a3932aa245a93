"""Measures of WANG12, formula by formula; both rules where the corrected one differs."""

from __future__ import annotations

import numpy as np
import pytest

from scanloom.stages.lod import View
from scanloom.stages.lod.refinement_measures import (
    compute_frustum_ratio,
    compute_global_limit,
    compute_local_measure,
    compute_marked_weight,
    compute_silhouette_weight,
)

# Camera at the origin, viewing along +z.
VIEW = View((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 100, 100, 90.0)


def test_the_global_limit_falls_from_all_triangles_to_the_minimum() -> None:
    limits = [compute_global_limit(1000, 10, d, near=1.0, far=11.0) for d in (0.0, 1.0, 6.0, 11.0, 50.0)]
    assert limits == [1000, 1000, 505, 10, 10]


def test_the_frustum_ratio_is_the_visible_part() -> None:
    middle = np.array([[0.0, 0, 5], [0, 0, -5], [5, 0, 5]])
    radius = np.ones(3)
    assert compute_frustum_ratio(VIEW, middle, radius).tolist() == [1, 0, 1]
    # In the paper, only spheres that cross the frustum get the ratio of their vertices.
    inside, vertices = np.array([1.0, 0, 1]), np.array([3.0, 2, 2])
    assert compute_frustum_ratio(VIEW, middle, radius, inside, vertices).tolist() == [1, 0, 0.5]


def compute_weight(degrees: float, rule: str) -> float:
    """Compute the weight of a small flat cell ahead, with this angle between normal and view direction."""
    turn = np.radians(degrees)
    axis = np.array([[np.sin(turn), 0.0, np.cos(turn)]])
    found = compute_silhouette_weight(
        VIEW,
        np.array([[0.0, 0, 10]]),
        np.array([0.01]),
        axis,
        np.array([0.05]),
        rule=rule,  # type: ignore[arg-type]
    )
    return float(found[0])


def test_both_rules_give_back_faces_no_weight_and_front_faces_full_weight() -> None:
    assert compute_weight(10, "paper") == compute_weight(10, "corrected") == 0
    assert compute_weight(180, "paper") == 1
    assert compute_weight(180, "corrected") == pytest.approx(0.5)


def test_at_the_silhouette_the_papers_weight_is_negative_and_the_corrected_one_largest() -> None:
    assert compute_weight(88, "paper") == pytest.approx(-np.cos(np.radians(88)))
    assert compute_weight(88, "paper") < 0
    assert compute_weight(88, "corrected") == compute_weight(92, "corrected") == 1
    assert compute_weight(120, "corrected") == pytest.approx(np.sin(np.radians(120)))


def test_inside_a_cell_the_weight_is_one() -> None:
    one = compute_silhouette_weight(VIEW, np.zeros((1, 3)), np.ones(1), np.array([[0.0, 0, 1]]), np.zeros(1))
    assert one.tolist() == [1]


def test_in_the_papers_rule_leaves_of_a_shared_region_stay_below_one_half() -> None:
    constrained, vertices = np.array([30.0, 10, 10, 10, 0]), np.array([100.0, 10, 20, 10, 50])
    is_handle = np.array([True, True, False, True, False])
    np.testing.assert_allclose(
        compute_marked_weight(is_handle, constrained, vertices, rule="paper"), [1, 1 / 3, 0, 1 / 3, 0]
    )
    np.testing.assert_allclose(compute_marked_weight(is_handle, constrained, vertices), [1, 1, 0.5, 1, 0])
    none = np.zeros(5)
    np.testing.assert_array_equal(compute_marked_weight(is_handle, none, vertices, rule="paper"), none)
    np.testing.assert_array_equal(compute_marked_weight(is_handle, none, vertices), is_handle)


def test_the_local_measure_is_one_above_either_threshold() -> None:
    frustum, silhouette = np.array([1.0, 1, 0, 0.5]), np.array([0.5, 0.5, 1, 0.8])
    error, marked = np.array([0.83, 0.0, 9.0, 0.5]), np.array([0.0, 0.51, 0.0, 0.45])
    np.testing.assert_allclose(compute_local_measure(frustum, silhouette, error, marked), [1, 1, 0, 0.45])
    # In the paper, nodes outside the screen are refined as well.
    np.testing.assert_allclose(
        compute_local_measure(frustum, silhouette, error, marked, rule="paper"), [1, 1, 1, 0.45]
    )
