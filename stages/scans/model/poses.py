"""Rigid poses as files tell them: checked, turned to OpenCV's axes, inverted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import POSE_INVALID

Pose = NDArray[np.float64]

# How far a rotation may be from orthonormal: files round to about six digits.
_RIGID_TOLERANCE = 1e-3
# Metres or radians; nobody carries a camera so far.
LARGEST_VALUE = 1e9
# Radians: no camera turns by more while it reads one image.
_MOST_TURN = 1.0

# From a camera with y up and z back (OpenGL) to one with y down and z forward.
_FLIP = np.diag((1.0, -1.0, -1.0, 1.0))

# How poses can be meant, whatever the form of their file says.
WORLD_TO_CAMERA, Y_UP, WORLD_TO_CAMERA_Y_UP = "world-to-camera", "y-up", "world-to-camera-y-up"
AS_WRITTEN = "as-written"
CONVENTIONS = (AS_WRITTEN, WORLD_TO_CAMERA, Y_UP, WORLD_TO_CAMERA_Y_UP)


def inverted(pose: Pose) -> Pose:
    """Return the inverse of a rigid (4, 4) pose: the other direction of the same relation."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def from_opengl(pose: Pose) -> Pose:
    """Return the world_from_camera of a camera whose own axes were OpenGL's: x right, y up, z back."""
    return np.asarray(pose @ _FLIP)


def meant(pose: Pose, convention: str) -> Pose:
    """Return the world_from_camera of a pose that is meant by one of `CONVENTIONS`."""
    if convention in (WORLD_TO_CAMERA, WORLD_TO_CAMERA_Y_UP):
        pose = inverted(pose)
    return from_opengl(pose) if convention in (Y_UP, WORLD_TO_CAMERA_Y_UP) else pose


def rigid(matrix: NDArray[np.float64], path: Path | str, where: str = "") -> Pose | None:
    """Return a valid 4x4 rigid pose from a 3x4 or 4x4 matrix; None when all of it is infinite or NaN (lost).

    Raises
    ------
    InputError
        If only some values are not finite, the rotation is not orthonormal to 1e-3 or mirrors (det -1), or
        the last row is not 0 0 0 1.
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
            words=_words(matrix[3]),
        )
    rotation = top[:, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        deviation = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    # Numbers that overflow leave NaN, which is not within the tolerance either.
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
    if np.abs(top[:, 3]).max() > LARGEST_VALUE:
        raise InputError(
            POSE_INVALID, "{at}a place of {max:g} cannot be right.", path, at=at, max=np.abs(top[:, 3]).max()
        )
    pose = np.eye(4)
    pose[:3] = top
    return pose


def divided(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a (4, 4) matrix over the last number of its last row, where that makes its 3x3 part a rotation.

    Multiplied by a number as a whole, its last row with it, a pose in homogeneous coordinates is the same.
    """
    if matrix[3, :3].any() or not 0 < matrix[3, 3] < math.inf:
        return matrix
    with np.errstate(over="ignore", invalid="ignore"):
        whole = matrix / matrix[3, 3]
        deviation = np.abs(whole[:3, :3].T @ whole[:3, :3] - np.eye(3)).max()
    return whole if deviation <= _RIGID_TOLERANCE else matrix


def turn_of(value: object, path: Path, where: str) -> NDArray[np.float64]:
    """Return the (3,) rotation vector by which a camera turns while its rows are read, as a file tells it.

    Raises
    ------
    InputError
        If it is not three numbers, of no more than a radian together.
    """
    numbers = value if isinstance(value, list) and all(type(one) in (int, float) for one in value) else []
    if len(numbers) != 3 or not math.hypot(*numbers) <= _MOST_TURN:
        raise InputError(
            POSE_INVALID,
            "{place}: shutter_turn is no rotation vector of three numbers, {most_turn:g} radian at most.",
            path,
            place=where,
            most_turn=_MOST_TURN,
        )
    return np.array(numbers, np.float64)


def pose_from_quaternion(
    translation: Sequence[float], quaternion: Sequence[float], path: Path, where: str
) -> Pose | None:
    """Return the pose of a translation and a quaternion x y z w of any length near 1; None when lost."""
    x, y, z, w = quaternion
    if not any(math.isfinite(value) for value in (*translation, *quaternion)):
        return None
    length = math.sqrt(x * x + y * y + z * z + w * w)
    # Real files round to four digits and more; far from unit length it is no rotation.
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
    return rigid(np.array(rotation), path, where)


def matrix_of(value: object, path: Path, where: str) -> NDArray[np.float64]:
    """Return a (4, 4) float64 matrix from nested rows or 16 numbers in a row."""
    try:
        matrix = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, (0, 0, 0, 1)])
    if matrix.size != 16:
        raise InputError(POSE_INVALID, "{place} is not a 4x4 matrix.", path, place=where)
    return matrix.reshape(4, 4)


def _words(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:g}" for value in values)
