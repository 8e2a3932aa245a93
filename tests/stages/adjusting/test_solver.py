"""The solver on a synthetic problem.

Derivatives equal finite differences, and disturbed parameters are recovered.
"""

from dataclasses import replace

import numpy as np
import pytest
from bundle_problem import BundleProblem, make_bundle_problem

from scanloom.stages.adjusting.bundle_adjustment import FitInput, fit_cameras
from scanloom.stages.adjusting.cameras import (
    CAMERA_PARAMETER_COUNT,
    Cameras,
    compute_motions,
    compute_pose_distance,
    decompose_motions,
)
from scanloom.stages.adjusting.color_camera_prior import (
    SilhouettePrior,
    compute_prior_residuals,
    create_silhouette_prior,
)
from scanloom.stages.adjusting.problem import AdjustmentProblem, AdjustmentState, FreeParameters
from scanloom.stages.adjusting.resection import fit_poses_separately
from scanloom.stages.adjusting.surface_points import SurfacePoints
from scanloom.stages.adjusting.unprojection import unproject_pixels

pytestmark = pytest.mark.slow

PRIOR = np.array([0.02] * 3 + [np.radians(0.6)] * 3)


@pytest.fixture(scope="module")
def make_scene() -> BundleProblem:
    return make_bundle_problem()


def sample_surface_points(make_scene: BundleProblem) -> SurfacePoints:
    couples = [
        (a, b) for a in range(len(make_scene.views)) for b in (a - 1, a + 1) if 0 <= b < len(make_scene.views)
    ]
    return SurfacePoints.from_views(make_scene.views, np.array(couples))


def make_fit_input(make_scene: BundleProblem, given: Cameras) -> FitInput:
    return FitInput(make_scene.views, given, sample_surface_points(make_scene), PRIOR)


def make_problem(make_scene: BundleProblem, given: np.ndarray, frees: FreeParameters) -> AdjustmentProblem:
    return AdjustmentProblem.from_tracks(
        make_scene.tracks, given, PRIOR, surfaces=sample_surface_points(make_scene), free=frees, width=320
    )


def measure_pose_errors(one: Cameras, other: Cameras) -> np.ndarray:
    """Compute distances between poses in metres and degrees, without their common motion."""
    common = one.poses @ np.linalg.inv(other.poses)
    into = compute_motions(decompose_motions(common).mean(axis=0)[None])[0]
    return np.array([compute_pose_distance(a, into @ b) for a, b in zip(one.poses, other.poses, strict=True)])


def disturb_poses(make_scene: BundleProblem, rng: np.random.Generator) -> Cameras:
    steps = rng.normal(size=(len(make_scene.views), 6)) * np.array([0.006] * 3 + [np.radians(0.3)] * 3)
    return replace(make_scene.cameras, poses=make_scene.cameras.poses @ compute_motions(steps))


def test_motions_and_steps_are_inverse():
    steps = np.random.default_rng(1).normal(size=(20, 6)) * 0.5
    np.testing.assert_allclose(decompose_motions(compute_motions(steps)), steps, atol=1e-12)
    np.testing.assert_array_equal(compute_motions(np.zeros((2, 6))), np.tile(np.eye(4), (2, 1, 1)))


def test_points_are_unprojected_through_separate_cameras(make_scene):
    seen = unproject_pixels(
        make_scene.views, make_scene.cameras, make_scene.tracks.view_indices, make_scene.tracks.pixels
    )
    back = np.linalg.inv(make_scene.cameras.poses)[make_scene.tracks.view_indices]
    true = (
        np.einsum("nij,nj->ni", back[:, :3, :3], make_scene.points[make_scene.tracks.point_indices])
        + back[:, :3, 3]
    )
    known = ~np.isnan(seen[:, 0])
    assert known.mean() > 0.95
    assert np.median(np.linalg.norm(seen - true, axis=1)[known]) < 0.003


@pytest.mark.parametrize(("turns", "anchored"), [(False, False), (True, False), (False, True)])
def test_the_gradient_equals_finite_differences_of_the_cost(turns, anchored):
    make_scene = make_bundle_problem(degrees=0.3 if turns else 0.0)
    rng = np.random.default_rng(2)
    start = disturb_poses(make_scene, rng)
    if turns:
        start = replace(
            start,
            readout_rotations=start.readout_rotations
            + np.radians(0.03) * rng.normal(size=start.readout_rotations.shape),
        )
    state = AdjustmentState(
        start,
        make_scene.points + 0.003 * rng.normal(size=make_scene.points.shape),
        np.zeros(CAMERA_PARAMETER_COUNT),
    )
    stated = make_problem(
        make_scene, make_scene.cameras.poses, FreeParameters(camera=True, shutter=turns)
    ).update_planes(make_scene.views, state)
    if anchored:
        stated = replace(
            stated,
            silhouette_prior=SilhouettePrior(rng.uniform(0.5, 2, (2, 20, 3)), rng.uniform(100, 150, (2, 2))),
        )
    assert (stated.planes.depths > 0).mean() > 0.9
    assert (stated.surface_planes.depths > 0).mean() > 0.5
    linear = stated.linearise(state)
    views, count = len(make_scene.views), len(make_scene.points)
    weighed = linear.residuals[:, :, None]
    by = (linear.by_pose * weighed, linear.by_camera * weighed, linear.by_point * weighed)
    poses, camera, points = (one.sum(axis=1) for one in by)
    met, couple = linear.surface_residuals, stated.surfaces.pair_indices[stated.surfaces.pair_of_point]
    size = 9 if turns else 6
    moved, turned = np.zeros((2, views, size))
    moved[:, :6] = rng.normal(size=(views, 6))
    turned[:, 6:] = rng.normal(size=(views, size - 6))
    still = np.zeros((views, size))
    for name, direction in {
        "poses": (moved, np.zeros(CAMERA_PARAMETER_COUNT), np.zeros((count, 3))),
        "camera": (still, rng.normal(size=CAMERA_PARAMETER_COUNT), np.zeros((count, 3))),
        "points": (still, np.zeros(CAMERA_PARAMETER_COUNT), rng.normal(size=(count, 3))),
        **({"turns": (turned, np.zeros(CAMERA_PARAMETER_COUNT), np.zeros((count, 3)))} if turns else {}),
    }.items():
        step = 1e-7
        there, back = (
            stated.compute_cost(state.apply_step(*(sign * step * part for part in direction)))
            for sign in (1, -1)
        )
        told = (
            (poses * direction[0][make_scene.tracks.view_indices]).sum()
            + (linear.pose_gradient * direction[0]).sum()
            + (met.residuals[:, None] * met.by_first * direction[0][couple[:, 0]]).sum()
            + (met.residuals[:, None] * met.by_other * direction[0][couple[:, 1]]).sum()
            + camera.sum(axis=0) @ direction[1]
            + linear.camera_gradient @ direction[1]
            + (points * direction[2][make_scene.tracks.point_indices]).sum()
        )
        assert (there - back) / (2 * step) == pytest.approx(told, rel=2e-3), name


def test_poses_and_camera_are_recovered(make_scene):
    start = disturb_poses(make_scene, np.random.default_rng(4))
    given = replace(
        start,
        lenses=np.stack([view.lens for view in make_scene.views]),
        color_from_depth=np.tile(np.eye(4), (len(make_scene.views), 1, 1)),
    )
    found = fit_cameras(
        make_fit_input(make_scene, given), given, make_scene.tracks, FreeParameters(camera=True)
    )
    before, after = (
        measure_pose_errors(make_scene.cameras, given),
        measure_pose_errors(make_scene.cameras, found),
    )
    assert np.median(after[:, 0]) < 0.4 * np.median(before[:, 0])
    assert np.median(after[:, 1]) < 0.4 * np.median(before[:, 1])
    true = make_scene.cameras.lenses[0]
    assert found.lenses[0, 0] == pytest.approx(true[0], rel=0.01)
    assert found.lenses[0, 4] == pytest.approx(true[4], abs=0.015)
    assert np.abs(found.lenses - found.lenses[0]).max() == 0, "there is one camera"


def test_the_silhouette_prior_keeps_the_camera_aligned_with_depth(make_scene):
    """Feature points alone leave an error of a third of a pixel; the silhouette prior more than halves it."""
    shifted = make_scene.cameras.apply_step(
        np.zeros((len(make_scene.views), 6)), np.eye(CAMERA_PARAMETER_COUNT)[1] * 4
    )
    seen = np.random.default_rng(4).uniform((-0.4, -0.3, 1.0), (0.4, 0.3, 2.0), (200, 3))
    held = create_silhouette_prior(seen, make_scene.cameras)
    frees = FreeParameters(camera=True)
    free = fit_cameras(make_fit_input(make_scene, make_scene.cameras), shifted, make_scene.tracks, frees)
    anchored = fit_cameras(
        make_fit_input(make_scene, make_scene.cameras), shifted, make_scene.tracks, frees, held
    )
    assert np.linalg.norm(compute_prior_residuals(held, anchored)) < 0.5 * np.linalg.norm(
        compute_prior_residuals(held, free)
    )


def test_rolling_shutter_rotations_are_recovered_with_the_poses():
    make_scene = make_bundle_problem(views=8, points=600, degrees=1.0)
    start = replace(disturb_poses(make_scene, np.random.default_rng(8)), readout_rotations=np.zeros((8, 3)))

    def found(frees: FreeParameters) -> Cameras:
        return fit_cameras(make_fit_input(make_scene, start), start, make_scene.tracks, frees)

    rolling, at_once = found(FreeParameters(shutter=True)), found(FreeParameters())
    assert not at_once.readout_rotations.any()
    true = make_scene.cameras.readout_rotations
    assert np.linalg.norm(rolling.readout_rotations - true) < 0.2 * np.linalg.norm(true)
    apart, without = (
        np.median(measure_pose_errors(make_scene.cameras, one), axis=0) for one in (rolling, at_once)
    )
    assert (apart < 0.4 * without).all()


def test_each_camera_recovers_its_rotation_with_fixed_points():
    make_scene = make_bundle_problem(degrees=1.0)
    start = replace(make_scene.cameras, readout_rotations=np.zeros((6, 3)))
    stated = AdjustmentProblem.from_tracks(
        make_scene.tracks, start.poses, PRIOR, free=FreeParameters(shutter=True)
    )
    _, state = fit_poses_separately(
        make_scene.views,
        stated,
        AdjustmentState(start, make_scene.points, np.zeros(CAMERA_PARAMETER_COUNT)),
        4,
    )
    true = make_scene.cameras.readout_rotations
    assert np.linalg.norm(state.cameras.readout_rotations - true) < 0.1 * np.linalg.norm(true)
    np.testing.assert_array_equal(state.points, make_scene.points)


def test_a_common_rotation_of_all_cameras_is_attributed_to_the_lens():
    make_scene = make_bundle_problem(degrees=1.0)
    common = np.radians((1.0, -0.5, 0.3))
    start = replace(make_scene.cameras, readout_rotations=make_scene.cameras.readout_rotations + common)
    found = fit_cameras(
        make_fit_input(make_scene, start), start, make_scene.tracks, FreeParameters(shutter=True)
    )
    assert np.linalg.norm(found.readout_rotations.mean(axis=0)) < np.radians(0.1)


def test_surfaces_alone_bring_poses_together(make_scene):
    start = disturb_poses(make_scene, np.random.default_rng(6))
    nothing = make_scene.tracks.select(np.arange(make_scene.tracks.point_count) < 1)
    found = fit_cameras(
        make_fit_input(make_scene, start)._replace(pose_prior=50 * PRIOR), start, nothing, FreeParameters()
    )
    gaps = []
    for cameras in (start, found):
        surfaces = sample_surface_points(make_scene)
        state = AdjustmentState(cameras, np.zeros((1, 3)), np.zeros(CAMERA_PARAMETER_COUNT))
        stated = AdjustmentProblem.from_tracks(
            nothing, cameras.poses, PRIOR, surfaces=surfaces
        ).update_planes(make_scene.views, state)
        held = stated.surface_planes.depths > 0
        assert held.mean() > 0.5
        behind = stated.compute_surface_residuals(state)
        gaps.append(np.median(np.abs(behind[held])))
    assert gaps[1] < 0.3 * gaps[0]


def test_points_without_depth_change_nothing(make_scene):
    blind = [replace(view, depth=np.zeros_like(view.depth)) for view in make_scene.views]
    start = disturb_poses(make_scene, np.random.default_rng(7))
    assert (
        fit_cameras(
            FitInput(blind, start, SurfacePoints.create_empty(), PRIOR),
            start,
            make_scene.tracks,
            FreeParameters(camera=True),
        )
        is start
    )


def test_a_given_camera_is_unchanged(make_scene):
    start = disturb_poses(make_scene, np.random.default_rng(5))
    found = fit_cameras(make_fit_input(make_scene, start), start, make_scene.tracks, FreeParameters())
    np.testing.assert_array_equal(found.lenses, start.lenses)
    np.testing.assert_array_equal(found.color_from_depth, start.color_from_depth)
    assert np.median(measure_pose_errors(make_scene.cameras, found)[:, 1]) < 0.1 * np.median(
        measure_pose_errors(make_scene.cameras, start)[:, 1]
    )
