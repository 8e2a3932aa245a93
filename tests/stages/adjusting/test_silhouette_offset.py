"""Silhouettes reveal an offset between photos and depth to a third of a pixel; other photos are not moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from scanloom import Frame, adjust, inspect, read_scan
from scanloom.stages.adjusting.silhouette_offset import (
    _REFINE_BLUR_PX,
    PhotoOffset,
    _blur_profiles,
    _GradientProfiles,
    _OffsetScore,
    estimate_photo_offset,
    observe_silhouettes,
)
from scanloom.stages.adjusting.view import get_color_camera, get_color_from_depth
from scanloom.stages.inspecting.codes import CAMERA_COLOR_UNREGISTERED
from scanloom.stages.scans.model.images import read_color, read_depth

pytestmark = pytest.mark.slow

SAMPLE = Path(__file__).parents[3] / "samples" / "rgbd"


@pytest.fixture(scope="module")
def frames() -> Sequence[Frame]:
    return read_scan(SAMPLE).frames


def shift_photos(frames: Sequence[Frame], right: float, down: float) -> list[Frame]:
    """Shift the photos of frames against depth by a number of pixels."""
    step = np.float32([[1, 0, right], [0, 1, down]])
    return [
        replace(one, color=cv2.warpAffine(read_color(one), step, (320, 240), borderMode=cv2.BORDER_REPLICATE))
        for one in frames
    ]


def estimate_offset(frames: Sequence[Frame]) -> PhotoOffset | None:
    seen = observe_silhouettes(frames, range(len(frames)))
    return estimate_photo_offset(seen, get_color_camera(frames[0]), get_color_from_depth(frames[0]))


def test_registered_photos_have_no_offset(frames):
    found = estimate_offset(frames)
    assert np.hypot(*found.shift_px) < 0.3
    assert not found.is_clear


@pytest.mark.parametrize("shift", [(3.0, 0.0), (-2.4, 5.7), (0.0, -2.5), (6.3, 6.3), (-8.2, 0.6)])
def test_a_shift_of_all_photos_is_found(frames, shift):
    found = estimate_offset(shift_photos(frames[::2], *shift))
    assert found.shift_px == pytest.approx(shift, abs=0.35)
    assert found.is_clear


def test_a_camera_model_that_fits_the_photos_has_no_offset(frames):
    camera = replace(frames[0].camera, cx=frames[0].camera.cx + 4, cy=frames[0].camera.cy - 3)
    stated = [replace(one, color_camera=camera) for one in shift_photos(frames[::2], 4, -3)]
    found = estimate_offset(stated)
    assert np.hypot(*found.shift_px) < 0.3
    assert not found.is_clear


def test_a_wrong_translation_is_found_from_near_and_far_objects(frames):
    """The stated offset is 30 mm, the true one is 0: the error in pixels is larger for near objects."""
    apart = np.eye(4)
    apart[:2, 3] = 0.030, -0.006
    stated = [
        replace(one, color_camera=replace(one.camera, cx=one.camera.cx - 8), color_from_depth=apart)
        for one in frames
    ]
    found = estimate_offset(stated)
    assert found.is_clear
    assert 1000 * found.translation_m == pytest.approx((-30, 6), abs=3)
    assert found.near_shift_px[0] < -1
    camera = replace(stated[0].color_camera, cx=stated[0].color_camera.cx + found.principal_point_shift_px[0])
    assert (camera.cx, found.principal_point_shift_px[1]) == pytest.approx((frames[0].camera.cx, 0), abs=1.5)


def test_the_offset_is_in_pixels_of_the_stored_photos(frames):
    large = [
        replace(one, color=cv2.resize(one.color, (1280, 960), interpolation=cv2.INTER_CUBIC))
        for one in shift_photos(frames[::2], 2, -3)
    ]
    assert estimate_offset(large).shift_px == pytest.approx((8, -12), abs=1.4)


def test_objects_that_are_too_wide_in_depth_give_no_shift(frames):
    """Window matching makes objects wider on all sides."""
    wider = []
    for one in frames[::2]:
        depth = read_depth(one)
        near = cv2.erode(np.where(depth > 0, depth, np.float32(99)), np.ones((5, 5), np.uint8))
        wider.append(replace(one, depth=np.where(near < 99, near, 0).astype(np.float32)))
    found = estimate_offset(wider)
    assert found.thinning_px == pytest.approx(-2, abs=0.5)
    assert np.hypot(*found.shift_px) < 0.5
    assert not found.is_clear


def test_photos_with_different_shifts_are_not_clear(frames):
    both = [
        one
        for pair in zip(shift_photos(frames[::2], 5, 0), shift_photos(frames[1::2], -5, 0), strict=True)
        for one in pair
    ]
    assert not estimate_offset(both).is_clear


def test_photos_of_another_scene_are_not_clear(frames):
    photos = [read_color(one)[::-1, ::-1].copy() for one in frames]
    found = estimate_offset([replace(one, color=photo) for one, photo in zip(frames, photos, strict=True)])
    assert found is None or not found.is_clear


@pytest.mark.parametrize("color", [0, 127])
def test_plain_photos_are_not_clear(frames, color):
    plain = np.full((240, 320, 3), color, np.uint8)
    assert not estimate_offset([replace(one, color=plain) for one in frames[::4]]).is_clear


def test_too_few_silhouettes_give_no_estimate(frames):
    assert estimate_offset(frames[:1]) is None
    flat = np.ones((240, 320), np.float32)
    assert estimate_offset([replace(one, depth=flat) for one in frames[::6]]) is None
    assert observe_silhouettes([replace(one, depth=Path("none.png")) for one in frames[:3]], range(3)) == []


def test_photos_of_several_sizes_give_no_estimate(frames):
    small = [replace(one, color=cv2.resize(read_color(one), (160, 120))) for one in frames[:2]]
    assert observe_silhouettes([*frames[:2], *small], range(4)) == []


def test_the_colour_camera_is_moved_and_fitting_poses_are_kept(frames):
    frames = frames[::2]
    found = adjust(shift_photos(frames, 3.5, -2.5))
    assert found.accepted
    assert found.is_camera_adjusted
    assert not found.adjusted_indices
    camera, given = found.camera_after, frames[0].camera
    assert (camera.cx - given.cx, camera.cy - given.cy) == pytest.approx((3.5, -2.5), abs=0.35)
    assert (camera.fx, camera.fy) == (given.fx, given.fy)
    assert found.offset_before.is_clear
    assert np.hypot(*found.offset_after.shift_px) < 0.3
    assert "colour camera moved by 3." in found.reason
    assert all(
        np.array_equal(one.world_from_camera, was.world_from_camera)
        for one, was in zip(found.frames, frames, strict=True)
    )


def test_a_fixed_camera_is_unchanged(frames):
    found = adjust(shift_photos(frames[::3], 3.5, -2.5), camera=False)
    assert not found.is_camera_adjusted
    assert found.offset_before is None
    assert all(one.color_camera is None for one in found.frames)


def test_inspect_reports_the_offset(frames):
    scan = read_scan(SAMPLE)
    found = inspect(replace(scan, frames=shift_photos(frames, 5, 0)))
    (said,) = (str(one) for one in found.diagnostics if one.code == CAMERA_COLOR_UNREGISTERED.name)
    assert "5.0 px to the right" in said
    assert not any(one.code == CAMERA_COLOR_UNREGISTERED.name for one in inspect(scan).diagnostics)


def test_the_offset_of_a_real_colour_camera_is_found(shared_data):
    """A RealSense scan of a tabletop: overlays show depth to the left of the photos."""
    scan = read_scan(shared_data / "rgbd" / "tabletop_box_realsense")
    found = adjust(scan)
    assert found.is_camera_adjusted
    assert found.offset_before.shift_px == pytest.approx((4.5, 1.6), abs=0.7)
    assert np.hypot(*found.offset_after.shift_px) < 0.5
    assert found.error_after.median < 0.95


@pytest.mark.parametrize("sigma", [0.8, 1.5])
def test_profiles_are_blurred_as_by_scipy(sigma: float) -> None:
    profiles = np.random.default_rng(2).uniform(0, 50, (2, 3, 31))
    np.testing.assert_array_equal(_blur_profiles(profiles, sigma), gaussian_filter1d(profiles, sigma, axis=2))


def test_an_offset_without_depth_dependence_is_summed_over_depth() -> None:
    """The short sum over all depths equals the sum of each depth."""
    random = np.random.default_rng(3)
    score = _OffsetScore(
        _GradientProfiles(
            random.uniform(0, 50, (6, 64, 31)), random.uniform(1, 9, (6, 64)), random.uniform(-1, 1, 6)
        )
    )
    offsets = np.zeros((40, 5))
    offsets[:, [0, 1, 4]] = random.uniform(-4, 4, (40, 3))
    each_depth = offsets + np.array([0, 0, 1e-12, 0, 0])
    np.testing.assert_allclose(
        score.evaluate(offsets, _REFINE_BLUR_PX), score.evaluate(each_depth, _REFINE_BLUR_PX), rtol=1e-9
    )
