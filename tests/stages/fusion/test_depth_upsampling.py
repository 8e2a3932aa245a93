"""Depth upsampling guided by a photo.

Exact on planes, sharp at discontinuities, without intermediate depth.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.fusion.depth_upsampling import upsample_depth, upsample_frame, upsample_single_frame
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.model.scan import Camera, Frame, scale_camera

SMALL = Camera(40, 30, 50.0, 50.0, 19.5, 14.5)
NEAR, FAR = 1.0, 2.0


def compute_plane_depth(camera: Camera, at: float, across: float, down: float) -> np.ndarray:
    """Compute the depth of a plane: 1/z is `at` straight ahead and linear in x/z and y/z."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return (1 / (at + across * x + down * y)).astype(np.float32)


def make_scene(camera: Camera, edge: float) -> np.ndarray:
    """Make a slanted near plane to the left of a slanted edge, and a far plane to its right."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    near, far = (
        compute_plane_depth(camera, 1 / NEAR, 0.1, 0.2),
        compute_plane_depth(camera, 1 / FAR, -0.05, 0.1),
    )
    return np.where(x + 0.3 * y < edge, near, far)


def photo(depth: np.ndarray, near: tuple[int, ...], far: tuple[int, ...]) -> np.ndarray:
    noise = np.random.default_rng(1).normal(0, 3, (*depth.shape, 3))
    colors = np.where((depth < 1.5)[..., None], np.float64(near), np.float64(far))
    return np.clip(colors + noise, 0, 255).astype(np.uint8)


@given(
    factor=st.integers(2, 5),
    slope=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    seed=st.integers(0, 9),
)
@settings(max_examples=20, deadline=None)
def test_planes_are_kept_for_any_photo(factor, slope, seed):
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    color = np.random.default_rng(seed).integers(0, 256, (large.height, large.width, 3)).astype(np.uint8)
    found = upsample_depth(compute_plane_depth(SMALL, 1.0, *slope), color, factor)
    inside = slice(factor, -factor), slice(factor, -factor)
    truth = compute_plane_depth(large, 1.0, *slope)
    # Neighbours on an oblique plane may count as two surfaces; there the slope is underestimated.
    np.testing.assert_allclose(found[inside], truth[inside], rtol=1e-3)
    assert np.mean(np.abs(found[inside] / truth[inside] - 1) < 1e-5) > 0.9


@pytest.mark.parametrize("colors", [((200, 60, 60), (60, 60, 200)), ((120, 120, 120), (120, 120, 120))])
def test_no_depth_between_two_surfaces(colors):
    for factor in (2, 3, 4):
        large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
        truth = make_scene(large, 0.02)
        found = upsample_depth(make_scene(SMALL, 0.02), photo(truth, *colors), factor)
        near, far = (
            compute_plane_depth(large, 1 / NEAR, 0.1, 0.2),
            compute_plane_depth(large, 1 / FAR, -0.05, 0.1),
        )
        off = np.minimum(np.abs(found - near) / near, np.abs(found - far) / far)
        assert off.max() < 0.02


def test_the_photo_moves_the_edge_to_its_true_position():
    factor = 4
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    truth, small = make_scene(large, 0.023), make_scene(SMALL, 0.023)
    wrong = {
        name: float(np.mean(np.abs(upsample_depth(small, color, factor) - truth) > 0.1))
        for name, color in {
            "guided": photo(truth, (200, 60, 60), (60, 60, 200)),
            "grey": photo(truth, (120, 120, 120), (120, 120, 120)),
            "none": None,
        }.items()
    }
    assert wrong["guided"] < 0.4 * wrong["none"]
    assert wrong["grey"] < 1.3 * wrong["none"]


def test_ambiguous_colours_do_not_move_the_edge():
    # Stripes across the edge: near and far surface have both colours.
    factor = 4
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    small = make_scene(SMALL, 0.02)
    stripes = np.zeros((large.height, large.width, 3), np.uint8) + np.uint8(40)
    stripes[(np.arange(large.height) // 8) % 2 == 0] = 220
    guided, plain = upsample_depth(small, stripes, factor), upsample_depth(small, None, factor)
    assert np.mean(np.abs(guided - plain) > 0.1) < 0.005


def test_missing_samples_stay_missing_and_do_not_affect_neighbours():
    small = make_scene(SMALL, 0.02)
    holes = np.random.default_rng(4).random(small.shape) < 0.2
    small[holes] = 0
    found = upsample_depth(small, None, 3)
    np.testing.assert_array_equal(found == 0, np.repeat(np.repeat(holes, 3, axis=0), 3, axis=1))
    near = np.repeat(np.repeat(small, 3, axis=0), 3, axis=1)
    assert (np.abs(found - near)[found > 0] < 0.1 * near[found > 0]).mean() > 0.98


@pytest.mark.parametrize("depth", [np.zeros((3, 4), np.float32), np.full((1, 1), 2, np.float32)])
def test_tiny_depth_maps_are_repeated(depth):
    found = upsample_depth(depth, np.zeros((2 * depth.shape[0], 2 * depth.shape[1], 3), np.uint8), 2)
    np.testing.assert_array_equal(found, np.repeat(np.repeat(depth, 2, axis=0), 2, axis=1))


def test_pure_noise_gives_finite_depth_in_the_measured_range():
    small = np.random.default_rng(6).uniform(0.2, 9, (25, 30)).astype(np.float32)
    color = np.random.default_rng(7).integers(0, 256, (50, 60, 3)).astype(np.uint8)
    found = upsample_depth(small, color, 2)
    assert np.isfinite(found).all()
    assert 0.2 * 0.97 <= found.min() <= found.max() <= 9 * 1.04


def test_a_photo_of_another_size_is_refused():
    with pytest.raises(InputError, match="must be 80 × 60"):
        upsample_depth(make_scene(SMALL, 0), np.zeros((30, 40, 3), np.uint8), 2)


def make_frame(factor: int, **changes) -> Frame:
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    color = photo(make_scene(large, 0.02), (200, 60, 60), (60, 60, 200))
    given = {"color": color, "depth": make_scene(SMALL, 0.02), "world_from_camera": np.eye(4), **changes}
    return Frame("a", SMALL, **given)


def test_only_single_frames_with_a_larger_photo_are_upsampled_by_default():
    (larger,) = upsample_single_frame([make_frame(3)], FuseParams())
    assert (larger.camera.width, larger.depth.shape, larger.color.shape) == (80, (60, 80), (60, 80, 3))
    same = make_frame(1)
    for frames, params in (
        ([same], FuseParams()),
        ([make_frame(3)], FuseParams(upsample="off")),
        ([make_frame(3), make_frame(3)], FuseParams(upsample="guided")),
        ([make_frame(3, color=None)], FuseParams()),
        ([make_frame(3, depth=None)], FuseParams()),
    ):
        assert upsample_single_frame(frames, params) == frames
    (asked,) = upsample_single_frame([same], FuseParams(upsample="guided", upsample_factor=4))
    assert asked.depth.shape == (120, 160)


def test_confidence_and_masks_are_applied_before_upsampling():
    sure = np.full((30, 40), 2, np.uint8)
    sure[:10] = 1
    mask = np.full((30, 40), 255, np.uint8)
    mask[20:] = 0
    frame = make_frame(2, confidence=sure, min_confidence=2, mask=mask)
    found = upsample_frame(frame, FuseParams())
    assert (found.confidence, found.mask) == (None, None)
    assert not found.depth[:20].any()
    assert not found.depth[40:].any()
    assert (found.depth[20:40] > 0).all()


def test_a_colour_camera_with_an_offset():
    # The photo is taken 3 cm to the right, so the edge is at another position than in the depth map.
    factor, aside = 4, 0.03
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    color_from_depth = np.eye(4)
    color_from_depth[0, 3] = -aside
    u, v = np.meshgrid(np.arange(large.width), np.arange(large.height))
    x, y = (u - large.cx) / large.fx, (v - large.cy) / large.fy
    # Of the edge of the near plane, about 1 m away.
    near = (x + 0.3 * y + aside) < 0.02
    color = np.where(near[..., None], np.uint8([200, 60, 60]), np.uint8([60, 60, 200])).astype(np.uint8)
    frame = make_frame(factor, color=color, color_camera=large, color_from_depth=color_from_depth)
    found = upsample_frame(frame, FuseParams(upsample_factor=factor))
    assert (found.color_camera, found.color_from_depth) == (None, None)
    is_red = found.color[..., 0] > found.color[..., 2]
    assert np.mean(is_red == (make_scene(large, 0.02) < 1.5)) > 0.97


def test_upsampling_refines_voxels_of_single_frames_only():
    frames = [make_frame(3)]
    small, larger = fuse(frames, upsample="off"), fuse(frames)
    assert larger.voxel_size == pytest.approx(small.voxel_size / 2, rel=0.1)
    assert len(larger.mesh.triangles) > 2 * len(small.mesh.triangles)
    moved = np.eye(4)
    moved[0, 3] = 0.01
    several = [*frames, make_frame(3, world_from_camera=moved)]
    both = [fuse(several, upsample=how) for how in ("auto", "guided")]
    assert both[0].voxel_size == both[1].voxel_size
    assert both[0].pixels_used != both[1].pixels_used
    assert [one.upsampled for one in (small, larger, *both)] == [1, 2, 1, 2]
