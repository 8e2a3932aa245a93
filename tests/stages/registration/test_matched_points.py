"""Rigid motion of matched points: exact without errors, and with a correct covariance."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.registration.matched_points import (
    MatchedPoints,
    build_motion,
    combine_motions,
    decompose_motion,
    fit_motion,
    transform_information_to_source,
)
from scanloom.stages.scans.model.poses import invert_pose

FOCAL = 500.0
MOTION = build_motion(np.array([0.03, -0.12, 0.05, 0.2, -0.05, 0.1]))


def make_points(seed: int, *, pixel: float = 0.5, per_m: float = 0.0016, count: int = 300) -> MatchedPoints:
    """Make points measured by two cameras with independent errors of pixel and depth."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(1, 6, count)
    points = np.stack([rng.uniform(-0.6, 0.6, count) * z, rng.uniform(-0.4, 0.4, count) * z, z], axis=1)

    def measure_points(true: np.ndarray) -> np.ndarray:
        rays = true[:, :2] / true[:, 2:] + pixel / FOCAL * rng.standard_normal((count, 2))
        depth = true[:, 2] + per_m * true[:, 2] ** 2 * rng.standard_normal(count)
        return np.column_stack([rays * depth[:, None], depth])

    return MatchedPoints(
        measure_points(points), measure_points(points @ MOTION[:3, :3].T + MOTION[:3, 3]), FOCAL
    )


def test_exact_points_give_the_exact_motion() -> None:
    pose, _ = fit_motion(make_points(0, pixel=0, per_m=0), np.eye(4))
    np.testing.assert_allclose(pose, MOTION, atol=1e-9)


def test_the_information_matrix_predicts_the_errors() -> None:
    off, expected = [], []
    for seed in range(60):
        pose, information = fit_motion(make_points(seed), MOTION)
        off.append(decompose_motion(pose @ invert_pose(MOTION)))
        expected.append(np.sqrt(np.diag(np.linalg.inv(information))))
    ratio = np.std(off, axis=0) / np.mean(expected, axis=0)
    assert np.all((ratio > 0.6) & (ratio < 1.6))


def test_distant_points_with_poor_depth_do_not_affect_the_rotation() -> None:
    """A street: depth has errors of metres, while rays have errors of 0.001."""
    turns = [
        decompose_motion(fit_motion(make_points(seed, per_m=0.02), MOTION)[0] @ invert_pose(MOTION))[:3]
        for seed in range(10)
    ]
    assert np.abs(turns).max() < np.radians(0.1)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0, 0.3))
def test_wrong_matches_are_rejected(seed: int, share: float) -> None:
    there = make_points(seed)
    rng = np.random.default_rng(seed)
    target = there.target.copy()
    wrong = rng.random(len(target)) < share
    target[wrong] += rng.normal(0, 0.3, (int(wrong.sum()), 3))
    pose, _ = fit_motion(MatchedPoints(there.source, target, FOCAL), MOTION)
    assert np.linalg.norm((pose @ invert_pose(MOTION))[:3, 3]) < 0.02


def test_two_motions_are_combined_by_their_information() -> None:
    turn, shift = np.diag([1e8] * 3 + [1e-8] * 3), np.diag([1e-8] * 3 + [1e8] * 3)
    one, other = (
        build_motion(np.array(step)) for step in ([0.01, 0, 0, 0.03, 0, 0], [0.02, 0, 0, 0.02, 0, 0])
    )
    step = decompose_motion(combine_motions(one, turn, other, shift)[0])
    np.testing.assert_allclose(step, [0.01, 0, 0, 0.02, 0, 0], atol=1e-5)


def test_information_is_transformed_between_source_and_target() -> None:
    _, information = fit_motion(make_points(3), MOTION)
    step = np.array([1e-4, -2e-4, 3e-4, 1e-4, 5e-4, -2e-4])
    there = decompose_motion(MOTION @ build_motion(step) @ invert_pose(MOTION))
    np.testing.assert_allclose(
        step @ transform_information_to_source(information, MOTION) @ step,
        there @ information @ there,
        rtol=1e-3,
    )


def test_one_in_eight_points_is_held_out() -> None:
    used, held = make_points(0, count=80).split_held_out()
    assert (len(used), len(held)) == (70, 10)
    assert np.median(held.compute_transfer_errors(MOTION)) < 2
