"""Photos that differ in brightness here and there are brought to what the others say, and nothing else is."""

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


def picture() -> np.ndarray:
    return np.array(photo(0, pose(0.5, 0.5, z=-0.4)).color)


def glossy(frame: Frame, number: int) -> Frame:
    """The frame with a light that is reflected somewhere else in each photo."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    x, y = WIDTH * ((0.37 * number) % 1), HEIGHT * ((0.61 * number) % 1)
    light = 30 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 30**2))
    image = np.rint(np.array(frame.color) + light[..., None]).clip(0, 250)
    return replace(frame, color=np.where(np.array(frame.color) > 0, image, 0).astype(np.uint8))


def test_a_photo_that_is_brighter_here_and_there_is_made_even():
    drawn = picture()
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    brighter = 20 * np.sin(u / WIDTH * 2 * np.pi) * np.cos(v / HEIGHT * np.pi)
    seen = np.rint(drawn + brighter[..., None]).clip(0, 255).astype(np.uint8)
    even = apply_local_exposure(seen, estimate_local_exposure(drawn, ALL, seen, STILL))
    before, after = (np.abs(one.astype(int) - drawn).mean() for one in (seen, even))
    assert before > 6
    assert after < 0.25 * before


def test_an_even_photo_stays_as_it_is():
    drawn = picture()
    exposure = estimate_local_exposure(drawn, ALL, drawn, STILL)
    assert not exposure.any()
    assert np.array_equal(apply_local_exposure(drawn, exposure), drawn)


def test_what_is_something_else_or_is_not_seen_says_nothing_of_brightness():
    drawn = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    seen = drawn.copy()
    seen[40:80, 60:100] = (220, 30, 180)
    assert not estimate_local_exposure(drawn, ALL, seen, STILL).any()
    # The same patch in a colour nearer to what is there would count, but for what the mesh does not show.
    seen[40:80, 60:100] = 120
    assert np.abs(to_levels(estimate_local_exposure(drawn, ALL, seen, STILL))).max() > 10
    without = ALL.copy()
    without[40:80, 60:100] = False
    assert not estimate_local_exposure(drawn, without, seen, STILL).any()


def test_a_large_photo_is_made_as_even_as_a_small_one():
    size = (8 * WIDTH, 8 * HEIGHT)
    drawn = picture()
    seen = np.array(glossy(replace(photo(0, pose(0.5, 0.5, z=-0.4)), color=drawn), 1).color)
    small = estimate_local_exposure(drawn, ALL, seen, STILL)
    large_drawn, large_seen = (cv2.resize(one, size, interpolation=cv2.INTER_CUBIC) for one in (drawn, seen))
    large = estimate_local_exposure(large_drawn, np.ones(size[::-1], bool), large_seen, STILL)
    assert np.abs(to_levels(small)).max() > 5
    assert np.abs(to_levels(large) - to_levels(small)).max() < 1.5


def test_details_of_a_photo_stay():
    drawn = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    seen = drawn.copy()
    seen[:, ::2] += 16
    seen[:, 1::2] -= 16
    even = apply_local_exposure(seen, estimate_local_exposure(drawn, ALL, seen, STILL))
    assert np.abs(even.astype(int) - seen).max() <= 1


def test_lights_that_move_with_the_camera_leave_no_borders(monkeypatch: pytest.MonkeyPatch):
    # Few photos, each of a part of the wall: their borders are all over it.
    places = [(x, y) for x in (0.3, 0.5, 0.7) for y in (0.3, 0.5, 0.7)]
    frames = [glossy(photo(n, pose(x, y, z=-0.5)), n) for n, (x, y) in enumerate(places)]
    # Else none of either is seen.
    monkeypatch.setattr(photo_painting, "level_seams", lambda *_: None)
    with_it = texture(wall(), frames, format="png")
    monkeypatch.setattr(photo_painting, "estimate_local_exposure", lambda *_: np.zeros((18, 24, 3), np.int8))
    without = texture(wall(), frames, format="png", exposure=True)
    assert with_it.residual_exposure_levels > 1
    assert with_it.seam_ratio < 0.9 * without.seam_ratio
