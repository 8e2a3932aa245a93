"""Tags in photos, AprilTags and ArUco markers, as OpenCV finds them, to a small part of a pixel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import ColorImage

# Families of tags by the names people have for them, and OpenCV's: of each kind of ArUco the one that holds
# the others.
_DICTIONARIES = {
    "apriltag-36h11": "DICT_APRILTAG_36h11",
    "apriltag-25h9": "DICT_APRILTAG_25h9",
    "apriltag-16h5": "DICT_APRILTAG_16h5",
    "aruco-4x4": "DICT_4X4_1000",
    "aruco-5x5": "DICT_5X5_1000",
    "aruco-6x6": "DICT_6X6_1000",
    "aruco-7x7": "DICT_7X7_1000",
    "aruco-original": "DICT_ARUCO_ORIGINAL",
}
FAMILIES = tuple(_DICTIONARIES)
# Around a tag, as a share of its longest edge, and pixels: its white border is seen whole.
_AROUND, _AROUND_PX = 0.35, 4.0
# What a photo holds is light to the power of one over this.
_GAMMA = 2.2
# The finer detector counts from the corner of a pixel, not from its middle.
_FROM_CORNER_PX = 0.5


def find_tags(image: ColorImage, family: str) -> Mapping[int, NDArray[np.float64]]:
    """Return the corners (4, 2) of the black squares of tags in an image, pixels, by the tags' numbers.

    Corners of a square are found where lines along its edges meet: each of them alone lies inwards of where
    it is by a third of a pixel, which is a per cent of a small tag. A number that is there twice is left out.

    Parameters
    ----------
    image : without lens distortion.
    family : one of FAMILIES.
    """
    import cv2

    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARIES[family]))
    settings = cv2.aruco.DetectorParameters()
    coarse = _detected(cv2.aruco.ArucoDetector(dictionary, settings), grey)
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    fine = cv2.aruco.ArucoDetector(dictionary, settings)
    found = {}
    for number, corners in coarse:
        longest = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).max())
        around = _AROUND * longest + _AROUND_PX
        left, top = np.maximum(np.floor(corners.min(axis=0) - around), 0).astype(int).tolist()
        right, bottom = np.ceil(corners.max(axis=0) + around).astype(int).tolist()
        near = _as_light(grey[top:bottom, left:right])
        better = [own for other, own in _detected(fine, near) if other == number]
        if len(better) == 1 and sum(other == number for other, _ in coarse) == 1:
            found[number] = better[0] + (left, top) - _FROM_CORNER_PX
    return found


def _as_light(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image in proportion to light, the brightest 255.

    A lens blurs light, and photos hold about its root: in these, half of the way from black to white lies on
    the black side of an edge, so that a black square is too small, by 2 % where its edge is 40 pixels.
    """
    light = (grey / np.float32(max(int(grey.max()), 1))) ** np.float32(_GAMMA)
    return np.asarray(np.rint(255 * light), np.uint8)


def _detected(detector: Any, grey: NDArray[np.uint8]) -> list[tuple[int, NDArray[np.float64]]]:
    corners, numbers, _ = detector.detectMarkers(grey)
    if numbers is None:
        return []
    squares = (np.asarray(one, np.float64).reshape(4, 2) for one in corners)
    return list(zip(numbers.ravel().tolist(), squares, strict=True))
