"""Silhouettes are on the near side of depth discontinuities, and their normals point outward."""

from __future__ import annotations

import numpy as np
import pytest

from scanloom.stages.adjusting.silhouettes import detect_silhouettes

LEFT, TOP, RIGHT, BOTTOM = 60, 40, 119, 99


@pytest.fixture
def box_before_wall() -> np.ndarray:
    depth = np.full((140, 200), 2.0, np.float32)
    depth[TOP : BOTTOM + 1, LEFT : RIGHT + 1] = 1.0
    return depth


def detect_sides(depth: np.ndarray) -> dict[str, np.ndarray]:
    """Group silhouette points by the direction of their normals."""
    found = detect_silhouettes(depth)
    across, down = found.normals.T
    return {
        "left": found.pixels[across < -0.95],
        "right": found.pixels[across > 0.95],
        "top": found.pixels[down < -0.95],
        "bottom": found.pixels[down > 0.95],
    }


def test_each_side_of_a_box_is_between_its_last_pixel_and_the_wall(box_before_wall):
    found = detect_sides(box_before_wall)
    assert all(len(points) > 40 for points in found.values())
    assert found["left"][:, 0] == pytest.approx(LEFT - 0.5, abs=0.03)
    assert found["right"][:, 0] == pytest.approx(RIGHT + 0.5, abs=0.03)
    assert found["top"][:, 1] == pytest.approx(TOP - 0.5, abs=0.03)
    assert found["bottom"][:, 1] == pytest.approx(BOTTOM + 0.5, abs=0.03)
    depths = detect_silhouettes(box_before_wall).depths
    assert depths == pytest.approx(1.0)


def test_directions_have_length_one(box_before_wall):
    assert np.linalg.norm(detect_silhouettes(box_before_wall).normals, axis=1) == pytest.approx(1, abs=1e-5)


def test_a_lattice_of_gaps_does_not_move_silhouettes(box_before_wall):
    """Depth that was warped to another camera has many such gaps."""
    gaps = box_before_wall.copy()
    gaps[::4], gaps[:, ::4] = 0, 0
    whole, torn = detect_sides(box_before_wall), detect_sides(gaps)
    for side, points in whole.items():
        axis = 0 if side in ("left", "right") else 1
        assert np.median(torn[side][:, axis]) == pytest.approx(np.median(points[:, axis]), abs=1.0)


def test_missing_depth_next_to_an_object_counts_as_background(box_before_wall):
    """Depth from two viewpoints has an occlusion shadow on one side of each object."""
    shadow = box_before_wall.copy()
    shadow[TOP - 3 : BOTTOM + 4, LEFT - 10 : LEFT] = 0
    assert detect_sides(shadow)["left"][:, 0] == pytest.approx(LEFT - 0.5, abs=0.03)


def test_an_object_without_measured_background_has_no_silhouette(box_before_wall):
    box_before_wall[box_before_wall > 1.5] = 0
    assert not len(detect_silhouettes(box_before_wall).depths)


@pytest.mark.parametrize("depth", [0.0, 1.0])
def test_constant_depth_has_no_silhouette(depth):
    assert not len(detect_silhouettes(np.full((50, 60), depth, np.float32)).depths)


def test_a_slope_has_no_silhouette():
    rows = np.arange(100, dtype=np.float32)[:, None]
    assert not len(detect_silhouettes(1 + 0.01 * rows + np.zeros((1, 80), np.float32)).depths)


def test_noise_has_hardly_any_silhouettes():
    depth = np.random.default_rng(0).uniform(1, 3, (120, 160)).astype(np.float32)
    assert len(detect_silhouettes(depth).depths) < 0.002 * depth.size


def test_depth_with_any_holes_is_accepted(box_before_wall):
    rng = np.random.default_rng(1)
    for share in (0.1, 0.5, 0.9, 0.999):
        holed = np.where(rng.random(box_before_wall.shape) < share, 0, box_before_wall).astype(np.float32)
        found = detect_silhouettes(holed)
        assert np.isfinite(found.pixels).all()
        assert (found.depths > 0).all()
