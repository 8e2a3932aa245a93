"""A known depth distortion is recovered together with the poses; exact depth is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bundle_problem import make_bundle_problem

from scanloom import Frame, adjust, read_scan
from scanloom.stages.adjusting.cameras import CAMERA_PARAMETER_COUNT, compute_motions
from scanloom.stages.adjusting.depth_calibration import (
    compute_depth_precision,
    create_neutral_correction,
    estimate_pose_scale,
)
from scanloom.stages.adjusting.problem import AdjustmentProblem, AdjustmentState, FreeParameters
from scanloom.stages.adjusting.surface_points import SurfacePoints
from scanloom.stages.scans.model.depth_correction import (
    COEFFICIENT_COUNT,
    POSITION_COUNT,
    DepthCorrection,
)
from scanloom.stages.scans.model.images import read_depth

SAMPLE = Path(__file__).parents[3] / "samples" / "rgbd"


def make_correction(values: Sequence[float] | None = None) -> DepthCorrection:
    values = np.random.default_rng(3).normal(size=COEFFICIENT_COUNT) * 0.01 if values is None else values
    return DepthCorrection(320, 240, 0.5, 2.5, tuple(map(float, values)))


def bend(columns: np.ndarray, rows: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Compute a relative depth error of about ±1 % with mean 0."""
    x, y = 2 * columns / size[0] - 1, 2 * rows / size[1] - 1
    return 0.012 * (x**2 - 1 / 3) + 0.012 * (y**2 - 1 / 3) + 0.006 * x - 0.004 * x * y


def disturb(frames: Sequence[Frame], *, scale: float = 1.0, bent: bool = True) -> list[Frame]:
    """Make frames with inexact poses and scaled depth, which is also distorted if `bent`."""
    rng, result = np.random.default_rng(1), []
    steps = np.array([0.004] * 3 + [np.radians(0.3)] * 3)
    for frame in frames:
        depth = read_depth(frame)
        assert depth is not None
        rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
        wrong = scale * (1 + bent * bend(columns, rows, depth.shape[::-1]))
        pose = frame.world_from_camera @ compute_motions(rng.normal(size=(1, 6)) * steps)[0]
        result.append(replace(frame, depth=(depth * wrong).astype(np.float32), world_from_camera=pose))
    return result


@pytest.fixture(scope="module")
def frames() -> Sequence[Frame]:
    return read_scan(SAMPLE).frames


def measure_error(
    given: Sequence[Frame], truth: Sequence[Frame], correction: DepthCorrection | None
) -> float:
    """Compute the standard deviation of relative depth errors in percent."""
    errors = []
    for one, other in zip(given, truth, strict=True):
        depth, true = read_depth(replace(one, depth_correction=correction)), read_depth(other)
        known = (depth > 0) & (true > 0)
        errors.append((depth[known] / true[known])[::50])
    together = np.concatenate(errors)
    return float(100 * (together / together.mean()).std())


def test_correcting_a_map_equals_correcting_its_pixels():
    correction = make_correction()
    rows, columns = np.mgrid[:240, :320]
    depth = np.random.default_rng(1).uniform(0.3, 3, (240, 320)).astype(np.float32)
    depth[:20] = 0
    single = correction.correct_at(columns.ravel(), rows.ravel(), depth.ravel().astype(np.float64))
    np.testing.assert_allclose(correction.correct_map(depth).ravel(), single, atol=2e-6)
    assert correction.correct_map(depth).dtype == np.float32
    assert (correction.correct_map(depth)[:20] == 0).all()


def test_a_larger_map_of_the_same_view_gets_the_same_correction():
    correction = make_correction()
    small = correction.correct_map(np.full((240, 320), 1.5, np.float32))
    large = correction.correct_map(np.full((480, 640), 1.5, np.float32))
    np.testing.assert_allclose(large.reshape(240, 2, 320, 2).mean(axis=(1, 3)), small, atol=1e-4)


def test_corrected_depth_is_scaled():
    correction, depth = make_correction(), np.full((240, 320), 1.2, np.float32)
    scaled = correction.scale_depth(1.03).correct_map(depth)
    np.testing.assert_allclose(scaled, 1.03 * correction.correct_map(depth), rtol=1e-6)


def test_frames_are_read_with_their_correction(frames):
    correction, frame = make_correction(), frames[0]
    expected = correction.correct_map(read_depth(frame))
    np.testing.assert_array_equal(read_depth(replace(frame, depth_correction=correction)), expected)


@pytest.mark.slow
def test_the_gradient_by_depth_coefficients_equals_finite_differences():
    scene, rng = make_bundle_problem(), np.random.default_rng(2)
    neutral = create_neutral_correction(scene.views)
    assert neutral is not None
    views = [replace(view, depth_correction=neutral) for view in scene.views]
    pairs = np.array([(n, n + 1) for n in range(len(views) - 1)])
    surfaces = SurfacePoints.from_views(views, pairs).with_depth_basis(views)
    problem = AdjustmentProblem.from_tracks(
        scene.tracks,
        scene.cameras.poses,
        np.ones(6),
        surfaces=surfaces,
        free=FreeParameters(depth=True),
        depth_precision=compute_depth_precision(surfaces.basis),
    )
    state = AdjustmentState(
        scene.cameras,
        scene.points + 0.003 * rng.normal(size=scene.points.shape),
        np.zeros(CAMERA_PARAMETER_COUNT),
        0.002 * rng.normal(size=COEFFICIENT_COUNT),
    )
    problem = problem.update_planes(views, state)
    linear = problem.linearise(state)
    still = np.zeros((len(views), 6)), np.zeros_like(scene.points)
    direction = np.concatenate([np.zeros(CAMERA_PARAMETER_COUNT), rng.normal(size=COEFFICIENT_COUNT)])
    step = 1e-7
    there, back = (
        problem.compute_cost(state.apply_step(still[0], sign * step * direction, still[1]))
        for sign in (1, -1)
    )
    gradient = (linear.by_camera * linear.residuals[:, :, None]).sum(axis=(0, 1)) + linear.camera_gradient
    met = linear.surface_residuals
    gradient[CAMERA_PARAMETER_COUNT:] += (met.by_depth * met.residuals[:, None]).sum(axis=0)
    assert (there - back) / (2 * step) == pytest.approx(gradient @ direction, rel=1e-4)


@pytest.mark.slow
def test_a_depth_distortion_is_recovered(frames):
    wrong = disturb(frames)
    found = adjust(wrong)
    assert found.accepted, found.reason
    assert found.depth_correction is not None
    assert "depth adjusted" in found.reason
    before = measure_error(wrong, frames, None)
    after = measure_error(wrong, frames, found.depth_correction)
    assert after < 0.5 * before, (before, after)
    metrics = found.to_dict()
    assert metrics["depth_corrected"]
    assert metrics["depth_distance_after_mm"] < metrics["depth_distance_before_mm"]
    assert all(frame.depth_correction == found.depth_correction for frame in found.frames)


@pytest.mark.slow
def test_exact_depth_is_kept(frames):
    found = adjust(disturb(frames, bent=False))
    assert found.accepted, found.reason
    assert found.depth_correction is None
    assert not found.to_dict()["depth_corrected"]
    assert "depth adjusted" not in found.reason


@pytest.mark.slow
def test_only_metric_poses_fix_the_scale(frames):
    wrong = disturb(frames, scale=1.015)
    factors = []
    for is_metric in (True, False):
        found = adjust(wrong, depth=True, has_metric_poses=is_metric)
        assert found.depth_correction is not None
        depths = [
            (read_depth(one), read_depth(other)) for one, other in zip(found.frames, frames, strict=True)
        ]
        factors.append(np.median([np.median(a[a > 0]) / np.median(b[b > 0]) for a, b in depths]))
    assert factors[0] == pytest.approx(1, abs=0.004)
    assert factors[1] == pytest.approx(1.015, abs=0.004)


@pytest.mark.slow
def test_depth_is_kept_on_request_or_if_already_corrected(frames):
    wrong = disturb(frames[::2])
    assert adjust(wrong, depth=False).depth_correction is None
    stored = make_correction(np.zeros(COEFFICIENT_COUNT))
    given = [replace(frame, depth_correction=stored) for frame in wrong]
    found = adjust(given, depth=True)
    assert found.depth_correction is None
    assert found.frames[0].depth_correction == stored


@pytest.mark.parametrize(
    ("scale", "noise", "expected"), [(1.02, 0.002, 1.02), (1.0, 0.002, None), (1.3, 0, None)]
)
def test_the_scale_of_poses_is_only_used_if_significant(scale, noise, expected):
    rng = np.random.default_rng(4)
    fitted = rng.normal(size=(60, 3))
    found = estimate_pose_scale(scale * fitted + noise * rng.normal(size=fitted.shape), fitted)
    assert found == (None if expected is None else pytest.approx(expected, abs=1e-3))


def test_drifting_poses_do_not_fix_the_scale():
    along = np.linspace(0, 1, 100)[:, None]
    fitted = np.concatenate([along, 0.2 * np.sin(9 * along), 0.1 * np.cos(7 * along)], axis=1)
    drift = 0.03 * np.sin(3 * along + np.array([0.0, 1.0, 2.0]))
    assert estimate_pose_scale(fitted + drift, fitted) is None


def test_coefficients_are_ordered_by_position_then_range():
    values = np.zeros(COEFFICIENT_COUNT)
    values[POSITION_COUNT] = 0.01
    correction = make_correction(values)
    depth = np.array([[0.5, 1.5, 2.5, 9.0]], np.float32)
    np.testing.assert_allclose(correction.correct_map(depth) / depth, [[0.99, 1, 1.01, 1.01]], rtol=1e-6)
