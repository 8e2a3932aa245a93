"""Local exposure differences between photos are corrected, and nothing else is changed."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from wall_photos import CAMERA, photo, pose, wall

from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.texturing import photo_painting
from scanloom.stages.texturing.local_exposure import apply_local_exposure, estimate_local_exposure, to_levels
from scanloom.stages.texturing.texture import texture

HEIGHT, WIDTH = CAMERA.height, CAMERA.width
STILL = np.zeros((61, 81, 2), np.float16)
ALL = np.ones((HEIGHT, WIDTH), bool)


def make_picture() -> np.ndarray:
    return np.array(photo(0, pose(0.5, 0.5, z=-0.4)).color)


def add_reflection(frame: Frame, number: int) -> Frame:
    """Add a reflected light at a different position in each photo."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    x, y = WIDTH * ((0.37 * number) % 1), HEIGHT * ((0.61 * number) % 1)
    light = 30 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 30**2))
    image = np.rint(np.array(frame.color) + light[..., None]).clip(0, 250)
    return replace(frame, color=np.where(np.array(frame.color) > 0, image, 0).astype(np.uint8))


def test_local_brightness_differences_are_corrected():
    drawn = make_picture()
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    brighter = 20 * np.sin(u / WIDTH * 2 * np.pi) * np.cos(v / HEIGHT * np.pi)
    seen = np.rint(drawn + brighter[..., None]).clip(0, 255).astype(np.uint8)
    even = apply_local_exposure(seen, estimate_local_exposure(drawn, ALL, seen, STILL))
    before, after = (np.abs(one.astype(int) - drawn).mean() for one in (seen, even))
    assert before > 6
    assert after < 0.25 * before


def test_a_uniform_photo_is_unchanged():
    drawn = make_picture()
    exposure = estimate_local_exposure(drawn, ALL, drawn, STILL)
    assert not exposure.any()
    assert np.array_equal(apply_local_exposure(drawn, exposure), drawn)


def test_other_content_and_unseen_pixels_do_not_affect_exposure():
    drawn = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    seen = drawn.copy()
    seen[40:80, 60:100] = (220, 30, 180)
    assert not estimate_local_exposure(drawn, ALL, seen, STILL).any()
    # The same patch with a closer colour would count, except for pixels that the mesh does not cover.
    seen[40:80, 60:100] = 120
    assert np.abs(to_levels(estimate_local_exposure(drawn, ALL, seen, STILL))).max() > 10
    without = ALL.copy()
    without[40:80, 60:100] = False
    assert not estimate_local_exposure(drawn, without, seen, STILL).any()


def test_large_photos_are_corrected_like_small_ones():
    size = (8 * WIDTH, 8 * HEIGHT)
    drawn = make_picture()
    seen = np.array(add_reflection(replace(photo(0, pose(0.5, 0.5, z=-0.4)), color=drawn), 1).color)
    small = estimate_local_exposure(drawn, ALL, seen, STILL)
    large_drawn, large_seen = (cv2.resize(one, size, interpolation=cv2.INTER_CUBIC) for one in (drawn, seen))
    large = estimate_local_exposure(large_drawn, np.ones(size[::-1], bool), large_seen, STILL)
    assert np.abs(to_levels(small)).max() > 5
    assert np.abs(to_levels(large) - to_levels(small)).max() < 1.5


def test_details_of_a_photo_are_kept():
    drawn = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    seen = drawn.copy()
    seen[:, ::2] += 16
    seen[:, 1::2] -= 16
    even = apply_local_exposure(seen, estimate_local_exposure(drawn, ALL, seen, STILL))
    assert np.abs(even.astype(int) - seen).max() <= 1


def test_moving_reflections_leave_no_seams(monkeypatch: pytest.MonkeyPatch):
    # Few photos of parts of the wall, so that their borders are everywhere.
    places = [(x, y) for x in (0.3, 0.5, 0.7) for y in (0.3, 0.5, 0.7)]
    frames = [add_reflection(photo(n, pose(x, y, z=-0.5)), n) for n, (x, y) in enumerate(places)]
    # Levelling would remove the seams in both results.
    monkeypatch.setattr(photo_painting, "level_seams", lambda *_: None)
    with_it = texture(wall(), frames, format="png")
    monkeypatch.setattr(photo_painting, "estimate_local_exposure", lambda *_: np.zeros((18, 24, 3), np.int8))
    without = texture(wall(), frames, format="png", exposure=True)
    assert with_it.residual_exposure_levels > 1
    assert with_it.seam_ratio < 0.9 * without.seam_ratio
