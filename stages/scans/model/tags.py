"""Detection of AprilTags and ArUco markers with subpixel corners."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import ColorImage

# OpenCV dictionaries by family name. For each ArUco size, the largest dictionary contains the smaller ones.
_OPENCV_DICTIONARIES = {
    "apriltag-36h11": "DICT_APRILTAG_36h11",
    "apriltag-25h9": "DICT_APRILTAG_25h9",
    "apriltag-16h5": "DICT_APRILTAG_16h5",
    "aruco-4x4": "DICT_4X4_1000",
    "aruco-5x5": "DICT_5X5_1000",
    "aruco-6x6": "DICT_6X6_1000",
    "aruco-7x7": "DICT_7X7_1000",
    "aruco-original": "DICT_ARUCO_ORIGINAL",
}
TAG_FAMILIES = tuple(_OPENCV_DICTIONARIES)
# Margin around a tag for the second detection: ratio of its longest edge, plus pixels. It includes the white
# border.
_MARGIN_RATIO, _MARGIN_PX = 0.35, 4.0
# Gamma of photos, approximately sRGB.
_GAMMA = 2.2
# The AprilTag refinement returns coordinates relative to pixel corners, not centres.
_PIXEL_CENTRE_OFFSET_PX = 0.5


def find_tags(image: ColorImage, family: str) -> Mapping[int, NDArray[np.float64]]:
    """Detect tags of a family in an image.

    Corners are intersections of lines fitted to the edges. Corner detectors are biased inwards by a third of
    a pixel, which is 1 % of a small tag. Tags whose id occurs twice are dropped.

    Parameters
    ----------
    image : (h, w, 3) uint8 RGB without lens distortion.
    family : one of FAMILIES.

    Returns
    -------
    Corners of the black square by tag id, (4, 2) pixels each.
    """
    import cv2

    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _OPENCV_DICTIONARIES[family]))
    settings = cv2.aruco.DetectorParameters()
    coarse = _detect_markers(cv2.aruco.ArucoDetector(dictionary, settings), grey)
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    fine = cv2.aruco.ArucoDetector(dictionary, settings)
    found = {}
    for number, corners in coarse:
        longest = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).max())
        margin = _MARGIN_RATIO * longest + _MARGIN_PX
        left, top = np.maximum(np.floor(corners.min(axis=0) - margin), 0).astype(int).tolist()
        right, bottom = np.ceil(corners.max(axis=0) + margin).astype(int).tolist()
        crop = _convert_to_linear(grey[top:bottom, left:right])
        refined = [own for other, own in _detect_markers(fine, crop) if other == number]
        if len(refined) == 1 and sum(other == number for other, _ in coarse) == 1:
            found[number] = refined[0] + (left, top) - _PIXEL_CENTRE_OFFSET_PX
    return found


def _convert_to_linear(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Linearise a grey image (inverse gamma), with the brightest pixel at 255.

    Lens blur is linear in light. In a gamma-encoded photo the half-way level of a blurred edge is on its dark
    side, so black squares appear too small: by 2 % for edges of 40 pixels.
    """
    light = (grey / np.float32(max(int(grey.max()), 1))) ** np.float32(_GAMMA)
    return np.asarray(np.rint(255 * light), np.uint8)


def _detect_markers(detector: Any, grey: NDArray[np.uint8]) -> list[tuple[int, NDArray[np.float64]]]:
    corners, numbers, _ = detector.detectMarkers(grey)
    if numbers is None:
        return []
    squares = (np.asarray(one, np.float64).reshape(4, 2) for one in corners)
    return list(zip(numbers.ravel().tolist(), squares, strict=True))
