"""Local exposure: smooth brightness corrections of each photo towards the texture.

Specular reflection, shadows of the operator and image processing in the camera differ between photos. One
gain and bias per photo cannot model them, and seams appear where the number of blended photos changes. The
textured mesh is rendered from each camera, and the smoothed difference is added to the photo. Seams fade
within the area that photos share, and never across areas that no photo shows. Pixels with a large difference
show another surface and are ignored.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.texturing.alignment import Shifts, no_larger, shifted

# Levels to add in the cells of a grid, in units of 1/3 level (`_PARTS`): 13 megabytes for 10,000 photos.
LocalExposure = NDArray[np.int8]
_PARTS = 3

# Standard deviation of the smoothing as a ratio of the photo's width. Half of it takes misalignment for
# brightness, and shifted photos become as blurred as the texture was.
_SMOOTH = 0.06
_COLUMNS = 24
# Maximum difference in levels; pixels that differ by more show another surface.
_ELSE = 40.0
# Weight of the prior that pulls the correction to 0, as a ratio of the pixels in the neighbourhood.
_PRIOR = 0.05
# Clipped levels (below `_DARK`, above `_BRIGHT`) get the low weight `_CUT_OFF`.
_DARK, _BRIGHT, _CUT_OFF = 4, 250, 0.1
# Maximum pixels of the compared images: larger ones take hundreds of megabytes and give the same result.
# `_SHARE` is the further downscaling factor for smoothing.
_MOST_PIXELS, _SHARE = 640 * 480, 4


def local_exposure_of(
    drawn: NDArray[np.uint8], shown: NDArray[np.bool_], photo: NDArray[np.uint8], shifts: Shifts
) -> LocalExposure:
    """Estimate the levels to add to a photo on a grid.

    Parameters
    ----------
    drawn : (h, w, 3) uint8, the textured mesh rendered from the photo's camera.
    shown : (h, w) bool, pixels of `drawn` that the mesh covers.
    photo : (h, w, 3) uint8.
    shifts : of the photo; see `scanloom.stages.texturing.alignment`.

    Returns
    -------
    (rows, columns, 3) int8, in units of 1/3 level.
    """
    import cv2

    given = shown.shape[1]
    drawn, shown, photo = no_larger(drawn, shown, photo, _MOST_PIXELS)
    height, width = shown.shape
    shifts = shifts * np.float16(width / given)
    moved = shifted(photo, shifts)
    # OpenCV instead of NumPy, which is slow over a last axis of length three.
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
    """Convert a correction to levels, (rows, columns, 3) float32."""
    return np.asarray(exposure / np.float32(_PARTS), np.float32)


def made_even(photo: NDArray[np.uint8], exposure: LocalExposure) -> NDArray[np.uint8]:
    """Add a local exposure correction to a photo (h, w, 3)."""
    import cv2

    size = photo.shape[1::-1]
    # One channel at a time: the float levels of a large photo would take four times its memory.
    planes = [
        cv2.add(plane, cv2.resize(levels, size, interpolation=cv2.INTER_LINEAR), dtype=cv2.CV_8U)
        for plane, levels in zip(cv2.split(photo), cv2.split(in_levels(exposure)), strict=True)
    ]
    return np.asarray(cv2.merge(planes), np.uint8)
