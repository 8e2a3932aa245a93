"""Refinement of disparities with subpixel errors by image agreement."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from scanloom.stages.stereo.subpixel_refinement import refine_disparity

HEIGHT, WIDTH = 120, 160


def make_pair(truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make a left image, and a right image whose pixel x − truth(x) shows left pixel x."""
    noise = gaussian_filter(np.random.default_rng(5).uniform(0, 255, (HEIGHT, WIDTH + 80)), 1.2)
    right = np.clip((noise - 127) * 4 + 127, 0, 255).astype(np.float32)
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    left = cv2.remap(right, u - truth.astype(np.float32), v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.clip(left, 0, 255).astype(np.uint8), right[:, :WIDTH].astype(np.uint8)


def make_slanted_disparity() -> np.ndarray:
    """Make the disparity of a plane, 8 to 16 px."""
    return 8 + 0.04 * np.arange(WIDTH)[None, :] + 0.015 * np.arange(HEIGHT)[:, None]


@pytest.mark.parametrize("bias", [-0.3, -0.1, 0.2, 0.4])
def test_four_fifths_of_a_constant_bias_are_removed_on_a_slanted_plane(bias: float) -> None:
    truth = make_slanted_disparity()
    left, right = make_pair(truth)

    result = refine_disparity(left, right, (truth + bias).astype(np.float32), np.ones(truth.shape, bool))

    inside = (slice(8, -8), slice(24, -8))
    assert abs(np.mean((result - truth)[inside])) < abs(bias) / 5


def test_exposure_differences_have_no_influence() -> None:
    truth = make_slanted_disparity()
    left, right = make_pair(truth)
    darker = (left.astype(np.float32) * 0.5).astype(np.uint8)
    everywhere = np.ones(truth.shape, bool)

    plain = refine_disparity(darker, (right * 0.5).astype(np.uint8), truth.astype(np.float32), everywhere)
    offset = refine_disparity(
        darker + 40, (right * 0.5).astype(np.uint8), truth.astype(np.float32), everywhere
    )

    inside = (slice(8, -8), slice(24, -8))
    assert np.abs(plain - offset)[inside].max() < 0.02


def test_only_used_pixels_move_by_at_most_one_pixel() -> None:
    truth = make_slanted_disparity()
    left, right = make_pair(truth)
    given = (truth + np.random.default_rng(1).normal(0, 3, truth.shape)).astype(np.float32)
    given[:, 40] = np.nan
    used = np.zeros(truth.shape, bool)
    used[20:100, 30:140] = True
    used &= np.isfinite(given)

    result = refine_disparity(left, right, given, used)

    np.testing.assert_array_equal(result[~used], given[~used])
    assert np.abs(result - given)[used].max() <= 1
    assert np.isfinite(result[used]).all()


def test_an_untextured_image_changes_nothing() -> None:
    flat = np.full((HEIGHT, WIDTH), 120, np.uint8)
    given = make_slanted_disparity().astype(np.float32)
    np.testing.assert_allclose(
        refine_disparity(flat, flat, given, np.ones(given.shape, bool)), given, atol=1e-4
    )
