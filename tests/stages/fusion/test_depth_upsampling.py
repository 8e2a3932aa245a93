"""Small depth made larger by a photo: exact on planes, one side or the other at jumps, nothing between."""

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


def inverse_plane(camera: Camera, at: float, across: float, down: float) -> np.ndarray:
    """Depth of a plane: 1/z is `at` straight ahead and linear in x/z and y/z."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return (1 / (at + across * x + down * y)).astype(np.float32)


def scene(camera: Camera, edge: float) -> np.ndarray:
    """A slanted near plane left of a slanting edge, and a far one right of it."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    near, far = inverse_plane(camera, 1 / NEAR, 0.1, 0.2), inverse_plane(camera, 1 / FAR, -0.05, 0.1)
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
def test_planes_are_kept_whatever_the_photo_shows(factor, slope, seed):
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    color = np.random.default_rng(seed).integers(0, 256, (large.height, large.width, 3)).astype(np.uint8)
    found = upsample_depth(inverse_plane(SMALL, 1.0, *slope), color, factor)
    inside = slice(factor, -factor), slice(factor, -factor)
    truth = inverse_plane(large, 1.0, *slope)
    # So oblique that neighbours may be of two surfaces, they are taken for less oblique than they are.
    np.testing.assert_allclose(found[inside], truth[inside], rtol=1e-3)
    assert np.mean(np.abs(found[inside] / truth[inside] - 1) < 1e-5) > 0.9


@pytest.mark.parametrize("colors", [((200, 60, 60), (60, 60, 200)), ((120, 120, 120), (120, 120, 120))])
def test_no_depth_between_two_surfaces(colors):
    for factor in (2, 3, 4):
        large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
        truth = scene(large, 0.02)
        found = upsample_depth(scene(SMALL, 0.02), photo(truth, *colors), factor)
        near, far = inverse_plane(large, 1 / NEAR, 0.1, 0.2), inverse_plane(large, 1 / FAR, -0.05, 0.1)
        off = np.minimum(np.abs(found - near) / near, np.abs(found - far) / far)
        assert off.max() < 0.02


def test_the_photo_moves_the_edge_to_where_it_is():
    factor = 4
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    truth, small = scene(large, 0.023), scene(SMALL, 0.023)
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


def test_colours_that_do_not_tell_the_sides_apart_move_no_edge():
    # Stripes across the edge: near and far have both colours.
    factor = 4
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    small = scene(SMALL, 0.02)
    stripes = np.zeros((large.height, large.width, 3), np.uint8) + np.uint8(40)
    stripes[(np.arange(large.height) // 8) % 2 == 0] = 220
    guided, plain = upsample_depth(small, stripes, factor), upsample_depth(small, None, factor)
    assert np.mean(np.abs(guided - plain) > 0.1) < 0.005


def test_missing_samples_stay_missing_and_spoil_no_neighbour():
    small = scene(SMALL, 0.02)
    holes = np.random.default_rng(4).random(small.shape) < 0.2
    small[holes] = 0
    found = upsample_depth(small, None, 3)
    np.testing.assert_array_equal(found == 0, np.repeat(np.repeat(holes, 3, axis=0), 3, axis=1))
    near = np.repeat(np.repeat(small, 3, axis=0), 3, axis=1)
    assert (np.abs(found - near)[found > 0] < 0.1 * near[found > 0]).mean() > 0.98


@pytest.mark.parametrize("depth", [np.zeros((3, 4), np.float32), np.full((1, 1), 2, np.float32)])
def test_next_to_nothing(depth):
    found = upsample_depth(depth, np.zeros((2 * depth.shape[0], 2 * depth.shape[1], 3), np.uint8), 2)
    np.testing.assert_array_equal(found, np.repeat(np.repeat(depth, 2, axis=0), 2, axis=1))


def test_noise_alone_gives_finite_depth_within_what_was_measured():
    small = np.random.default_rng(6).uniform(0.2, 9, (25, 30)).astype(np.float32)
    color = np.random.default_rng(7).integers(0, 256, (50, 60, 3)).astype(np.uint8)
    found = upsample_depth(small, color, 2)
    assert np.isfinite(found).all()
    assert 0.2 * 0.97 <= found.min() <= found.max() <= 9 * 1.04


def test_a_photo_of_another_size_is_refused():
    with pytest.raises(InputError, match="must be 80 × 60"):
        upsample_depth(scene(SMALL, 0), np.zeros((30, 40, 3), np.uint8), 2)


def framed(factor: int, **changes) -> Frame:
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    color = photo(scene(large, 0.02), (200, 60, 60), (60, 60, 200))
    given = {"color": color, "depth": scene(SMALL, 0.02), "world_from_camera": np.eye(4), **changes}
    return Frame("a", SMALL, **given)


def test_only_a_frame_alone_with_a_larger_photo_is_made_larger_by_itself():
    (larger,) = upsample_single_frame([framed(3)], FuseParams())
    assert (larger.camera.width, larger.depth.shape, larger.color.shape) == (80, (60, 80), (60, 80, 3))
    same = framed(1)
    for frames, params in (
        ([same], FuseParams()),
        ([framed(3)], FuseParams(upsample="off")),
        ([framed(3), framed(3)], FuseParams(upsample="guided")),
        ([framed(3, color=None)], FuseParams()),
        ([framed(3, depth=None)], FuseParams()),
    ):
        assert upsample_single_frame(frames, params) == frames
    (asked,) = upsample_single_frame([same], FuseParams(upsample="guided", upsample_factor=4))
    assert asked.depth.shape == (120, 160)


def test_confidence_and_masks_count_before():
    sure = np.full((30, 40), 2, np.uint8)
    sure[:10] = 1
    mask = np.full((30, 40), 255, np.uint8)
    mask[20:] = 0
    frame = framed(2, confidence=sure, min_confidence=2, mask=mask)
    found = upsample_frame(frame, FuseParams())
    assert (found.confidence, found.mask) == (None, None)
    assert not found.depth[:20].any()
    assert not found.depth[40:].any()
    assert (found.depth[20:40] > 0).all()


def test_a_colour_camera_that_stands_aside():
    # The photo is taken 3 cm to the right: the edge lies elsewhere in it than in the depth map.
    factor, aside = 4, 0.03
    large = scale_camera(SMALL, factor * SMALL.width, factor * SMALL.height)
    color_from_depth = np.eye(4)
    color_from_depth[0, 3] = -aside
    u, v = np.meshgrid(np.arange(large.width), np.arange(large.height))
    x, y = (u - large.cx) / large.fx, (v - large.cy) / large.fy
    # Of the near plane's edge, about a metre away.
    near = (x + 0.3 * y + aside) < 0.02
    color = np.where(near[..., None], np.uint8([200, 60, 60]), np.uint8([60, 60, 200])).astype(np.uint8)
    frame = framed(factor, color=color, color_camera=large, color_from_depth=color_from_depth)
    found = upsample_frame(frame, FuseParams(upsample_factor=factor))
    assert (found.color_camera, found.color_from_depth) == (None, None)
    is_red = found.color[..., 0] > found.color[..., 2]
    assert np.mean(is_red == (scene(large, 0.02) < 1.5)) > 0.97


def test_fusing_a_frame_alone_gives_finer_voxels_and_several_the_same():
    frames = [framed(3)]
    small, larger = fuse(frames, upsample="off"), fuse(frames)
    assert larger.voxel_size == pytest.approx(small.voxel_size / 2, rel=0.1)
    assert len(larger.mesh.triangles) > 2 * len(small.mesh.triangles)
    moved = np.eye(4)
    moved[0, 3] = 0.01
    several = [*frames, framed(3, world_from_camera=moved)]
    both = [fuse(several, upsample=how) for how in ("auto", "guided")]
    assert both[0].voxel_size == both[1].voxel_size
    assert both[0].pixels_used != both[1].pixels_used
    assert [one.upsampled for one in (small, larger, *both)] == [1, 2, 1, 2]
