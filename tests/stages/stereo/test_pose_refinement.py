"""Pose refinement of views by feature matches: inexact poses improve, exact poses are kept."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import posed_scene
import pytest
from scipy.spatial.transform import Rotation

from scanloom.stages.stereo.pose_refinement import refine_poses
from scanloom.stages.stereo.posed_views import PosedView

CAMERA = posed_scene.CAMERA
Matched = Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]


def make_views(count: int) -> list[PosedView]:
    """Make views on a half circle at two heights."""
    return [
        PosedView(CAMERA, posed_scene.pose(angle, 10.0 * (k % 2)), 0.8, 1.6)
        for k, angle in enumerate(np.linspace(-60, 60, count))
    ]


def disturb_views(views: list[PosedView], turned: float, moved: float) -> list[PosedView]:
    """Disturb views by random rotations in degrees and shifts in metres (standard deviations)."""
    random = np.random.default_rng(3)
    found = []
    for view in views:
        pose = view.world_from_camera.copy()
        pose[:3, :3] @= Rotation.from_rotvec(random.normal(0, turned, 3), degrees=True).as_matrix()
        pose[:3, 3] += random.normal(0, moved, 3)
        found.append(PosedView(view.camera, pose, view.near, view.far))
    return found


def match_points(views: list[PosedView], *, wrong: float = 0.0) -> Matched:
    """Match points of a cloud between neighbouring views with noise of half a pixel; `wrong` is a ratio."""
    random = np.random.default_rng(4)
    points = random.uniform(-0.25, 0.25, (80, 3))
    matched = {}
    for a in range(len(views)):
        for b in range(a + 1, min(a + 3, len(views))):
            pixels = []
            for view in (views[a], views[b]):
                columns, rows, _ = view.project(points)
                pixels.append(np.stack([columns, rows], axis=1) + random.normal(0, 0.5, (80, 2)))
            lost = random.random(80) < wrong
            pixels[1][lost] += random.normal(0, 5, (80, 2))[lost]
            matched[a, b] = pixels[0], pixels[1]
    return matched


def measure_rotation_error(views: list[PosedView], poses: list[np.ndarray]) -> float:
    """Compute the median rotation error between consecutive views in degrees."""
    off = []
    for k in range(len(views) - 1):
        true, found = (
            np.linalg.inv(one[k]) @ one[k + 1] for one in ([view.world_from_camera for view in views], poses)
        )
        off.append(np.degrees(Rotation.from_matrix(true[:3, :3].T @ found[:3, :3]).magnitude()))
    return float(np.median(off))


@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_inexact_poses_improve(wrong: float) -> None:
    views = make_views(9)
    given = disturb_views(views, 0.5, 0.005)
    nearer = refine_poses(given, match_points(views, wrong=wrong), 1.2)
    assert nearer is not None
    assert nearer.error_after < 1 < 4 < nearer.error_before
    before = measure_rotation_error(views, [view.world_from_camera for view in given])
    assert measure_rotation_error(views, list(nearer.poses)) < before / 2
    for pose in nearer.poses:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)


def test_exact_poses_are_kept() -> None:
    views = make_views(9)
    assert refine_poses(views, match_points(views), 1.2) is None


def test_without_matches_poses_are_kept() -> None:
    assert refine_poses(make_views(3), {}, 1.2) is None
    nothing = np.zeros((0, 2))
    assert refine_poses(make_views(3), {(0, 1): (nothing, nothing)}, 1.2) is None
