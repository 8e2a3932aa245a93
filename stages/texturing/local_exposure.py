"""How bright a photo is here and there, beside what the others say.

Gloss, shadows of whoever holds the camera and what cameras make of a picture beyond one gain and bias differ
from photo to photo. Where one more of them counts, or one fewer, a border would be seen. The mesh with the
texture so far is drawn from each camera; what the photo differs by, smoothed, is added to it. So borders
fade over what photos show together, and never across what no photo shows. Where a photo differs by much, it
shows something else, which says nothing of its brightness.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.texturing.alignment import Shifts, no_larger, shifted

# Thirds of levels to add in the cells of a grid: of ten thousand photos they take 13 megabytes.
LocalExposure = NDArray[np.int8]
_PARTS = 3

# Of a photo's width: spread of the smoothing. With half of it what is out of place is taken for brightness,
# and photos that are shifted get as blurred as the texture was.
_SMOOTH = 0.06
_COLUMNS = 24
# Levels beyond which a pixel shows something else.
_ELSE = 40.0
# What holds the levels to 0 where hardly anything is known: a share of the pixels around.
_PRIOR = 0.05
# Levels of photos that are cut off say little.
_DARK, _BRIGHT, _CUT_OFF = 4, 250, 0.1
# Differences are looked at in images of no more pixels, since larger ones tell no more and take hundreds of
# megabytes, and smoothed in ones that are smaller by this.
_MOST_PIXELS, _SHARE = 640 * 480, 4


def local_exposure_of(
    drawn: NDArray[np.uint8], shown: NDArray[np.bool_], photo: NDArray[np.uint8], shifts: Shifts
) -> LocalExposure:
    """Return what is to be added to a photo, (rows, columns, 3) in the cells of a grid.

    Parameters
    ----------
    drawn : (h, w, 3) uint8, the textured mesh from the photo's camera.
    shown : (h, w), where it shows the mesh.
    photo : (h, w, 3) uint8.
    shifts : of the photo; see `scanloom.stages.texturing.alignment`.
    """
    import cv2

    given = shown.shape[1]
    drawn, shown, photo = no_larger(drawn, shown, photo, _MOST_PIXELS)
    height, width = shown.shape
    shifts = shifts * np.float16(width / given)
    moved = shifted(photo, shifts)
    # OpenCV's functions: NumPy is slow over a last axis of three.
    red, green, blue = cv2.split(cv2.absdiff(drawn, moved))
    apart = cv2.max(cv2.max(red, green), blue)
    sound = np.maximum(1 - (np.arange(256, dtype=np.float32) / _ELSE) ** 2, 0) ** 2
    weight = np.where(shown, cv2.LUT(apart, sound), np.float32(0))
    is_whole = cv2.inRange(moved, np.full(3, float(_DARK)), np.full(3, float(_BRIGHT))) > 0
    weight = np.where(is_whole, weight, weight * np.float32(_CUT_OFF))
    size = (max(round(width / _SHARE), 2), max(round(height / _SHARE), 2))
    difference = cv2.subtract(drawn, moved, dtype=cv2.CV_32F)
    weighed = cv2.multiply(difference, cv2.merge([weight] * 3))
    sums, total = (cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (weighed, weight))
    spread = _SMOOTH * size[0]
    total = cv2.GaussianBlur(total, (0, 0), spread) + np.float32(_PRIOR)
    levels = cv2.GaussianBlur(sums, (0, 0), spread) / total[..., None]
    rows = max(round(_COLUMNS * height / width), 2)
    parts = _PARTS * cv2.resize(levels, (_COLUMNS, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(parts), np.int8)


def in_levels(exposure: LocalExposure) -> NDArray[np.float32]:
    """Return the levels to add, (rows, columns, 3)."""
    return np.asarray(exposure / np.float32(_PARTS), np.float32)


def made_even(photo: NDArray[np.uint8], exposure: LocalExposure) -> NDArray[np.uint8]:
    """Return a photo (h, w, 3) with what is to be added."""
    import cv2

    size = photo.shape[1::-1]
    # A channel at a time: all of a large photo's levels would take four times as much as itself.
    planes = [
        cv2.add(plane, cv2.resize(levels, size, interpolation=cv2.INTER_LINEAR), dtype=cv2.CV_8U)
        for plane, levels in zip(cv2.split(photo), cv2.split(in_levels(exposure)), strict=True)
    ]
    return np.asarray(cv2.merge(planes), np.uint8)
