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

from scanloom.stages.texturing.photo_alignment import Shifts, apply_shifts, limit_resolution

# Levels to add in the cells of a grid, in units of 1/3 level (`_STEPS_PER_LEVEL`): 13 megabytes for 10,000
# photos.
LocalExposure = NDArray[np.int8]
_STEPS_PER_LEVEL = 3

# Standard deviation of the smoothing as a ratio of the photo's width. Half of it takes misalignment for
# brightness, and shifted photos become as blurred as the texture was.
_SMOOTHING_RATIO = 0.06
_GRID_COLUMNS = 24
# Maximum difference in levels; pixels that differ by more show another surface.
_MAX_DIFFERENCE = 40.0
# Weight of the prior that pulls the correction to 0, as a ratio of the pixels in the neighbourhood.
_PRIOR_WEIGHT = 0.05
# Clipped levels (below `_MIN_LEVEL`, above `_MAX_LEVEL`) get the low weight `_CLIPPED_WEIGHT`.
_MIN_LEVEL, _MAX_LEVEL, _CLIPPED_WEIGHT = 4, 250, 0.1
# Maximum pixels of the compared images: larger ones take hundreds of megabytes and give the same result.
# `_DOWNSCALING` is the further downscaling factor for smoothing.
_MAX_PIXELS, _DOWNSCALING = 640 * 480, 4


def estimate_local_exposure(
    rendering: NDArray[np.uint8], mask: NDArray[np.bool_], photo: NDArray[np.uint8], shifts: Shifts
) -> LocalExposure:
    """Estimate the levels to add to a photo on a grid.

    Parameters
    ----------
    rendering : (h, w, 3) uint8, the textured mesh rendered from the photo's camera.
    mask : (h, w) bool, pixels of `rendering` that the mesh covers.
    photo : (h, w, 3) uint8.
    shifts : of the photo; see `scanloom.stages.texturing.photo_alignment`.

    Returns
    -------
    (rows, columns, 3) int8, in units of 1/3 level.
    """
    import cv2

    given_width = mask.shape[1]
    rendering, mask, photo = limit_resolution(rendering, mask, photo, _MAX_PIXELS)
    height, width = mask.shape
    shifts = shifts * np.float16(width / given_width)
    moved = apply_shifts(photo, shifts)
    # OpenCV instead of NumPy, which is slow over a last axis of length three.
    red, green, blue = cv2.split(cv2.absdiff(rendering, moved))
    max_difference = cv2.max(cv2.max(red, green), blue)
    agreement_by_difference = (
        np.maximum(1 - (np.arange(256, dtype=np.float32) / _MAX_DIFFERENCE) ** 2, 0) ** 2
    )
    weight = np.where(mask, cv2.LUT(max_difference, agreement_by_difference), np.float32(0))
    is_unclipped = cv2.inRange(moved, np.full(3, float(_MIN_LEVEL)), np.full(3, float(_MAX_LEVEL))) > 0
    weight = np.where(is_unclipped, weight, weight * np.float32(_CLIPPED_WEIGHT))
    size = (max(round(width / _DOWNSCALING), 2), max(round(height / _DOWNSCALING), 2))
    difference = cv2.subtract(rendering, moved, dtype=cv2.CV_32F)
    weighted_difference = cv2.multiply(difference, cv2.merge([weight] * 3))
    sums, total = (
        cv2.resize(values, size, interpolation=cv2.INTER_AREA) for values in (weighted_difference, weight)
    )
    spread = _SMOOTHING_RATIO * size[0]
    total = cv2.GaussianBlur(total, (0, 0), spread) + np.float32(_PRIOR_WEIGHT)
    levels = cv2.GaussianBlur(sums, (0, 0), spread) / total[..., None]
    rows = max(round(_GRID_COLUMNS * height / width), 2)
    steps = _STEPS_PER_LEVEL * cv2.resize(levels, (_GRID_COLUMNS, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(steps), np.int8)


def to_levels(exposure: LocalExposure) -> NDArray[np.float32]:
    """Convert a correction to levels, (rows, columns, 3) float32."""
    return np.asarray(exposure / np.float32(_STEPS_PER_LEVEL), np.float32)


def apply_local_exposure(photo: NDArray[np.uint8], exposure: LocalExposure) -> NDArray[np.uint8]:
    """Add a local exposure correction to a photo (h, w, 3)."""
    import cv2

    size = photo.shape[1::-1]
    # One channel at a time: the float levels of a large photo would take four times its memory.
    planes = [
        cv2.add(plane, cv2.resize(levels, size, interpolation=cv2.INTER_LINEAR), dtype=cv2.CV_8U)
        for plane, levels in zip(cv2.split(photo), cv2.split(to_levels(exposure)), strict=True)
    ]
    return np.asarray(cv2.merge(planes), np.uint8)
