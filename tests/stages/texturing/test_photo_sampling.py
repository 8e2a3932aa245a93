"""Blurring a photo at half resolution equals a Gaussian blur at full resolution."""

import cv2
import numpy as np
import pytest

from scanloom.stages.texturing.photo_sampling import _BLUR_RATIO, _blur_photo


def make_picture(width: int, height: int) -> np.ndarray:
    noise = np.random.default_rng(0).integers(0, 256, (height, width, 3)).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 2))


@pytest.mark.parametrize("size", [(160, 120), (427, 240), (640, 480), (641, 359), (1920, 1080)])
@pytest.mark.parametrize("is_masked", [False, True])
def test_a_photo_without_details(size: tuple[int, int], is_masked: bool):
    width, height = size
    image, seen = make_picture(width, height), np.ones((height, width), bool)
    if is_masked:
        # Masked pixels must not count, so they have the maximum value.
        seen[: height // 8] = seen[height // 2 :, : width // 3] = False
        image[~seen] = 255
    spread, weight = max(_BLUR_RATIO * width, 0.5), seen.astype(np.float32)
    wanted = cv2.GaussianBlur(image * weight[..., None], (0, 0), spread)
    wanted /= np.maximum(cv2.GaussianBlur(weight, (0, 0), spread), 1e-3)[..., None]
    off = np.abs(_blur_photo(image, seen if is_masked else None) - wanted)[seen]
    assert off.mean() < 0.6
    assert np.quantile(off, 0.999) < 4
