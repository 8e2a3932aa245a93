"""Checks of a pair before matching: sizes, swapped images, row alignment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_MISMATCH
from scanloom.stages.scans.model.scan import Camera
from scanloom.stages.stereo.codes import DEPTH_PAIR_ROWS_DIFFER, DEPTH_PAIR_SWAPPED

# Minimum number of matched corners for a check.
_MIN_CORNERS = 40
# Maximum row difference of matched corners, pixels; larger ones are false matches or an unrectified pair.
_MAX_ROW_DIFFERENCE_PX = 8.0
# Row difference in pixels above which the matcher misses the right match.
_ROW_TOLERANCE_PX = 0.5
# Maximum Hamming distance of ORB descriptors (of 256 bits) for the same point.
_MAX_HAMMING_DISTANCE = 40


def check_pair(
    left: NDArray[Any],
    right: NDArray[Any],
    camera: Camera,
    files: tuple[Path | None, Path | None] = (None, None),
) -> None:
    """Raise InputError unless both images are 8-bit and of the calibrated size."""
    for image, file, side in zip((left, right), files, ("left", "right"), strict=True):
        grey = image.ndim == 2
        if image.dtype != np.uint8 or not (grey or (image.ndim == 3 and image.shape[2] == 3)):
            raise InputError(
                USAGE_ARGUMENT_INVALID,
                "the {side} image must be (h, w) or (h, w, 3) uint8, not {image_shape} {image_dtype}.",
                file,
                side=side,
                image_shape=image.shape,
                image_dtype=image.dtype,
            )
    if left.shape[:2] != right.shape[:2]:
        other = f" ({files[0]})" if files[0] is not None else ""
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            "the right image is {size} px, but the left one{other} is {size_2} px",
            files[1],
            remedy="both images of a pair must have the same size.",
            size=_format_size(right),
            other=other,
            size_2=_format_size(left),
        )
    if left.shape[:2] != (camera.height, camera.width):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            "the image is {size} px, but its camera is calibrated for {camera_width}×{camera_height} px.",
            files[0],
            remedy="Use images of the calibrated size, or a calibration for this size.",
            size=_format_size(left),
            camera_width=camera.width,
            camera_height=camera.height,
        )


def check_rows(left: NDArray[np.uint8], right: NDArray[np.uint8], principal_offset: float) -> None:
    """Warn if the rows of a rectified grey pair do not correspond.

    The check uses corners matched between the images.

    Raises
    ------
    InputError
        If most disparities are negative: left and right are swapped.
    """
    shift = _match_corners(left, right)
    shift = shift[np.abs(shift[:, 1]) < _MAX_ROW_DIFFERENCE_PX]
    if len(shift) < _MIN_CORNERS:
        return
    disparity = shift[:, 0] + principal_offset
    if np.median(disparity) < -1:
        raise InputError(
            DEPTH_PAIR_SWAPPED,
            (
                "left and right images seem swapped: {mean:.0%} of the corners found in both "
                "are farther right in the right image."
            ),
            remedy="Swap the images.",
            mean=np.mean(disparity < 0),
        )
    rows = float(np.median(shift[:, 1]))
    if abs(rows) > _ROW_TOLERANCE_PX:
        emit(
            DEPTH_PAIR_ROWS_DIFFER.warning(
                "rows of the pair differ by {rows:.1f} px (median of {corners} corners), more than "
                "{tolerance:g} px: the calibration is inaccurate, and depth will have holes",
                rows=abs(rows),
                corners=len(shift),
                tolerance=_ROW_TOLERANCE_PX,
            )
        )


def _match_corners(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return left minus right position of matched corners, (n, 2) pixels."""
    import cv2

    orb = cv2.ORB.create(1000)
    (here, first), (there, second) = (orb.detectAndCompute(image, None) for image in (left, right))
    if not here or not there:
        return np.empty((0, 2))
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(first, second)
    shifts = [
        np.subtract(here[m.queryIdx].pt, there[m.trainIdx].pt)
        for m in matches
        if m.distance < _MAX_HAMMING_DISTANCE
    ]
    return np.array(shifts, np.float64).reshape(-1, 2)


def _format_size(image: NDArray[Any]) -> str:
    return f"{image.shape[1]}×{image.shape[0]}"
