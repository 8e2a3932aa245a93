"""Extent of a scan, and the point that its cameras face."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from object_on_table import BALL, OBJECT_POSITION, frames, pose

from scanloom.stages.frames.posed_depth import DepthLimits, read_posed_depth
from scanloom.stages.fusion.scene_extent import compute_scene_extent, intersect_optical_axes

LIMITS = DepthLimits(min_depth=0, max_depth=9, max_jump=0.05, max_angle=87)
AIM = np.array([*OBJECT_POSITION, 0.08])


def make_ring(*angles: float) -> NDArray[np.float64]:
    return np.array([pose(angle) for angle in angles])


def test_optical_axes_intersect_at_the_target() -> None:
    np.testing.assert_allclose(intersect_optical_axes(make_ring(0, 30, 60)), AIM, atol=1e-9)


def test_outlier_cameras_do_not_move_the_intersection() -> None:
    poses = make_ring(*range(0, 360, 20))
    poses[:4, :3, 3] += [0.4, 0.3, 0]
    place = intersect_optical_axes(poses)
    assert place is not None
    assert np.linalg.norm(place - AIM) < 0.03


@pytest.mark.parametrize("case", ["one", "ahead", "outwards", "none"])
def test_axes_without_intersection_in_front_give_no_target(case: str) -> None:
    poses = make_ring(0, 40, 80, 120)
    if case == "one":
        poses = poses[:1]
    elif case == "ahead":
        poses[:, :3, :3] = poses[0, :3, :3]
    elif case == "outwards":
        poses[:, :3, :3] @= np.diag([1.0, -1, -1])
    else:
        poses = poses[:0]
    assert intersect_optical_axes(poses) is None


def test_the_extent_ignores_outliers_and_is_centred_at_the_target() -> None:
    given = frames("ball")
    for frame in given:
        assert isinstance(frame.depth, np.ndarray)
        frame.depth[:1, :40] = 8.0
    scene = compute_scene_extent(given, [read_posed_depth(frame, LIMITS) for frame in given[::4]])
    assert np.abs(np.array(scene.lowest_m) - [-1.2, -1.2, -0.6]).max() < 0.3
    assert np.abs(np.array(scene.highest_m[:2]) - [1.2, 1.2]).max() < 0.3
    assert 0.05 < scene.highest_m[2] < 2 * BALL
    assert scene.center_m == pytest.approx(AIM.tolist(), abs=1e-6)
    assert str(scene).startswith("(-0.9")


def test_without_intersection_the_centre_is_the_median_of_image_centres() -> None:
    (one,) = frames("ball")[:1]
    scene = compute_scene_extent([one], [read_posed_depth(one, LIMITS)])
    assert np.linalg.norm(np.array(scene.center_m) - AIM) < 0.15
