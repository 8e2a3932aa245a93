"""Weights of photos relative to their neighbours in time."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from wall_photos import photos

from scanloom.stages.progress import ignore_progress
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.texturing.photos import load_photos


def blur_photo(frame: Frame, spread: float) -> Frame:
    return replace(frame, color=cv2.GaussianBlur(np.asarray(frame.color), (0, 0), spread))


def test_a_blurred_photo_has_a_weight_of_1_32():
    frames = photos(12)
    frames[5] = blur_photo(frames[5], 3.0)
    worths = load_photos(frames, ignore_progress).weights
    # Weights are squared in the blend.
    assert worths[5] ** 2 == pytest.approx(0.5**5)
    assert np.median(worths) == 1


def test_equally_blurred_photos_are_not_downweighted():
    sharp, soft = photos(12), [blur_photo(frame, 1.0) for frame in photos(12)]
    one, other = (load_photos(frames, ignore_progress).weights for frames in (sharp, soft))
    assert other == pytest.approx(one, abs=0.25)
