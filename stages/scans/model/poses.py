"""Rigid poses from files: validation, conversion to OpenCV axes, inversion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import POSE_INVALID

Pose = NDArray[np.float64]

# Maximum deviation of RᵀR from identity; files round to about six digits.
_RIGID_TOLERANCE = 1e-3
# Maximum plausible translation in metres or rotation in radians; larger values are damaged.
MAX_POSE_VALUE = 1e9
# Radians; no camera rotates more during the readout of one image.
_MAX_SHUTTER_TURN_RAD = 1.0

# From camera axes with y up and z backward (OpenGL) to y down and z forward (OpenCV).
_OPENCV_FROM_OPENGL = np.diag((1.0, -1.0, -1.0, 1.0))

# Pose conventions that the user can state if the file does not follow its format.
WORLD_TO_CAMERA, Y_UP, WORLD_TO_CAMERA_Y_UP = "world-to-camera", "y-up", "world-to-camera-y-up"
AS_WRITTEN = "as-written"
CONVENTIONS = (AS_WRITTEN, WORLD_TO_CAMERA, Y_UP, WORLD_TO_CAMERA_Y_UP)


def invert_pose(pose: Pose) -> Pose:
    """Invert a rigid (4, 4) pose."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def from_opengl(pose: Pose) -> Pose:
    """Convert world_from_camera (4, 4) from OpenGL to OpenCV camera axes.

    OpenGL: y up, z backward. OpenCV: y down, z forward.
    """
    return np.asarray(pose @ _OPENCV_FROM_OPENGL)


def to_camera_to_world(pose: Pose, convention: str) -> Pose:
    """Convert a (4, 4) pose of one of `CONVENTIONS` to world_from_camera in OpenCV axes."""
    if convention in (WORLD_TO_CAMERA, WORLD_TO_CAMERA_Y_UP):
        pose = invert_pose(pose)
    return from_opengl(pose) if convention in (Y_UP, WORLD_TO_CAMERA_Y_UP) else pose


def check_rigid_pose(matrix: NDArray[np.float64], path: Path | str, where: str = "") -> Pose | None:
    """Check a 3x4 or 4x4 matrix and return it as a rigid (4, 4) pose.

    Returns None if all values are infinite or NaN (lost tracking).

    Parameters
    ----------
    path : file for messages.
    where : location in the file for messages, such as a line.

    Raises
    ------
    InputError
        If some values are not finite, the rotation is not orthonormal to 1e-3 or is a reflection (det -1), a
        translation exceeds 1e9, or the last row is not 0 0 0 1.
    """
    at = f"{where}: " if where else ""
    top = np.asarray(matrix, np.float64)[:3]
    finite = np.isfinite(top)
    if not finite.any():
        return None
    if not finite.all():
        raise InputError(
            POSE_INVALID,
            "{at}the pose holds a value that is not finite; correct it or remove its frame.",
            path,
            at=at,
        )
    if len(matrix) == 4 and not np.allclose(matrix[3], (0, 0, 0, 1), atol=_RIGID_TOLERANCE):
        raise InputError(
            POSE_INVALID,
            "{at}the last row of the pose is {words}, not 0 0 0 1; is it stored column-major?",
            path,
            at=at,
            words=_format_row(matrix[3]),
        )
    rotation = top[:, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        deviation = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    # Overflow makes the deviation NaN; `not <=` rejects it.
    if not deviation <= _RIGID_TOLERANCE or np.linalg.det(rotation) < 0:
        kind = "mirrors (determinant -1)" if deviation <= _RIGID_TOLERANCE else "is not a rotation"
        raise InputError(
            POSE_INVALID,
            (
                "{at}the pose is not rigid: its 3x3 part {kind}, off by {deviation:.2g} "
                "where 0.001 is allowed."
            ),
            path,
            at=at,
            kind=kind,
            deviation=deviation,
        )
    if np.abs(top[:, 3]).max() > MAX_POSE_VALUE:
        raise InputError(
            POSE_INVALID,
            "{at}a translation of {max:g} is implausible.",
            path,
            at=at,
            max=np.abs(top[:, 3]).max(),
        )
    pose = np.eye(4)
    pose[:3] = top
    return pose


def normalise_homogeneous(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Divide a homogeneous (4, 4) pose by its last element.

    Only if its last row is 0 0 0 w and the result has a rotation as its 3x3 part; else the matrix is returned
    unchanged.
    """
    if matrix[3, :3].any() or not 0 < matrix[3, 3] < math.inf:
        return matrix
    with np.errstate(over="ignore", invalid="ignore"):
        whole = matrix / matrix[3, 3]
        deviation = np.abs(whole[:3, :3].T @ whole[:3, :3] - np.eye(3)).max()
    return whole if deviation <= _RIGID_TOLERANCE else matrix


def parse_shutter_turn(value: object, path: Path, where: str) -> NDArray[np.float64]:
    """Parse the rotation of a camera during readout.

    A (3,) rotation vector in radians, see `Frame.shutter_turn`.

    Raises
    ------
    InputError
        If the value is not three numbers, or the angle exceeds 1 radian.
    """
    numbers = value if isinstance(value, list) and all(type(one) in (int, float) for one in value) else []
    if len(numbers) != 3 or not math.hypot(*numbers) <= _MAX_SHUTTER_TURN_RAD:
        raise InputError(
            POSE_INVALID,
            "{place}: shutter_turn must be a rotation vector of three numbers, at most {most_turn:g} rad.",
            path,
            place=where,
            most_turn=_MAX_SHUTTER_TURN_RAD,
        )
    return np.array(numbers, np.float64)


def create_pose_from_quaternion(
    translation: Sequence[float], quaternion: Sequence[float], path: Path, where: str
) -> Pose | None:
    """Create a (4, 4) pose from a translation (metres) and a quaternion x y z w.

    Returns None if all values are infinite or NaN (lost tracking).

    Raises
    ------
    InputError
        If the length of the quaternion differs from 1 by more than 1 %.
    """
    x, y, z, w = quaternion
    if not any(math.isfinite(value) for value in (*translation, *quaternion)):
        return None
    length = math.sqrt(x * x + y * y + z * z + w * w)
    # Files round to four digits or more, so a larger deviation means that the values are not a quaternion.
    if not 0.99 < length < 1.01:
        raise InputError(
            POSE_INVALID,
            "{place}: the quaternion has length {length:.4g}, not 1.",
            path,
            place=where,
            length=length,
        )
    x, y, z, w = x / length, y / length, z / length, w / length
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), translation[0]],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), translation[1]],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), translation[2]],
    ]
    return check_rigid_pose(np.array(rotation), path, where)


def parse_pose_matrix(value: object, path: Path, where: str) -> NDArray[np.float64]:
    """Convert nested rows (3x4 or 4x4) or 16 row-major numbers to a (4, 4) float64 matrix.

    Raises
    ------
    InputError
        For other values.
    """
    try:
        matrix = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, (0, 0, 0, 1)])
    if matrix.size != 16:
        raise InputError(POSE_INVALID, "{place} is not a 4x4 matrix.", path, place=where)
    return matrix.reshape(4, 4)


def _format_row(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:g}" for value in values)
