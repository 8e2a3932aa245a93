"""Matching of left and right values in a stereo calibration by their key names.

    K1 K2    mtxL mtxR    camera_matrix_left camera_matrix_right    Intrinsic_mtx_1 Intrinsic_mtx_2

Two keys are a pair if they differ only in the side and their values have the right form. For the key names
of OpenCV's samples and tutorials the values are not checked here, so that errors in them are reported.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MATRIX_KEYS = (
    ("K1", "K2"),
    ("M1", "M2"),
    ("cameraMatrix1", "cameraMatrix2"),
    ("camera_matrix_left", "camera_matrix_right"),
    ("mtxL", "mtxR"),
    ("Kl", "Kr"),
)
_DISTORTION_KEYS = (
    ("D1", "D2"),
    ("dist1", "dist2"),
    ("distCoeffs1", "distCoeffs2"),
    ("dist_coeffs1", "dist_coeffs2"),
    ("dist_coeffs_left", "dist_coeffs_right"),
    ("distL", "distR"),
    ("Dl", "Dr"),
)
_SIDE_MARKS = (
    ("left", "right"),
    ("Left", "Right"),
    ("LEFT", "RIGHT"),
    ("l", "r"),
    ("L", "R"),
    ("1", "2"),
    ("0", "1"),
)
# Names of the new camera matrices after undistortion or rectification; they do not belong to the raw images.
# Longer keys are not names of cameras, and each of their letters could be a mark.
_MAX_KEY_LENGTH = 100
_RECTIFIED_NAME = re.compile("new|opt|rect|undist", re.IGNORECASE)
_DISTORTION_NAME = re.compile("dist|coef|^d", re.IGNORECASE)
_COEFFICIENT_COUNTS = (4, 5, 8, 12, 14)
# Pixels; a 3x3 matrix with ones on its diagonal is an identity or a rotation.
_MIN_FOCAL_LENGTH_PX = 2.0


def find_matrix_pair(values: dict[str, Any]) -> tuple[str, str] | None:
    """Return the keys of the left and right camera matrix.

    Returns None if not unique.
    """
    return _find_known_pair(values, _MATRIX_KEYS) or _find_matching_pair(
        values, lambda _, array: _is_camera_matrix(array)
    )


def find_distortion_pair(values: dict[str, Any]) -> tuple[str, str] | None:
    """Return the keys of the left and right distortion coefficients.

    Returns None if not unique.
    """
    return _find_known_pair(values, _DISTORTION_KEYS) or _find_matching_pair(
        values,
        lambda name, array: array.size in _COEFFICIENT_COUNTS and _DISTORTION_NAME.search(name) is not None,
    )


def _find_known_pair(values: dict[str, Any], names: tuple[tuple[str, str], ...]) -> tuple[str, str] | None:
    return next((keys for keys in names if keys[0] in values and keys[1] in values), None)


def _find_matching_pair(
    values: dict[str, Any], fits: Callable[[str, NDArray[np.float64]], bool]
) -> tuple[str, str] | None:
    fitting = {name for name, value in values.items() if fits(name, _to_array(value))}
    pairs = {(left, right) for left in fitting for right in _iterate_right_names(left) if right in fitting}
    if len(pairs) > 1:
        pairs = {pair for pair in pairs if not _RECTIFIED_NAME.search(pair[0])}
    return pairs.pop() if len(pairs) == 1 else None


def _iterate_right_names(name: str) -> Iterator[str]:
    """Yield the possible keys of the right camera for a key of the left camera."""
    if len(name) > _MAX_KEY_LENGTH:
        return
    for left, right in _SIDE_MARKS:
        for found in re.finditer(left, name):
            yield name[: found.start()] + right + name[found.end() :]


def _to_array(value: object) -> NDArray[np.float64]:
    """Convert a value (nested lists or an OpenCV matrix) to an array.

    The result is empty if not numeric.
    """
    try:
        return np.asarray(value["data"] if isinstance(value, dict) else value, np.float64)
    except (KeyError, TypeError, ValueError, OverflowError):
        return np.empty(0)


def _is_camera_matrix(array: NDArray[np.float64]) -> bool:
    if array.size != 9:
        return False
    matrix = array.reshape(3, 3)
    return (
        min(matrix[0, 0], matrix[1, 1]) >= _MIN_FOCAL_LENGTH_PX
        and not matrix[1, 0]
        and bool((matrix[2] == (0, 0, 1)).all())
    )
