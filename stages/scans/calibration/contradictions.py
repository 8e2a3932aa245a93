"""Warnings about contradicting numbers in a calibration."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.table_values import MATRIX_KEYS, get_matrix
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_CONTRADICTORY
from scanloom.stages.scans.model.scan import Camera, Pose, StereoRig

# Relative tolerances of baselines and focal lengths: files round, and rectification changes fx slightly.
_LENGTH_TOLERANCE = 0.02
_FOCAL_TOLERANCE = 0.01
# Factors between length units: m, cm, mm. Two values of a file may use different units.
_UNIT_FACTORS = (1.0, 100.0, 1000.0)
# Maximum ratio of focal lengths between the cameras of a pair, and between fx and fy.
_MAX_FOCAL_RATIO = 1.25
# P[0, 0] of a projection matrix that was left at identity.
_IDENTITY_FOCAL = 1.0
_ROTATION_TOLERANCE_DEG = 0.5


def check_rig(
    document: dict[str, Any], values: dict[str, Any], rig: StereoRig, length: float, path: Path
) -> None:
    """Warn about contradicting baselines and very different focal lengths.

    Parameters
    ----------
    document, values : content of the file as written, and with scanloom's calibration keys.
    rig : stereo rig created from the file.
    length : baseline that is used, in the unit of the file.
    """
    found = list(_find_baselines(document, values, path))
    others = [(name, value) for name, value in found if not _is_same_length(value, length)]
    if others:
        taken = next((name for name, value in found if _is_same_length(value, length)), "R and T")
        shown = " and ".join(f"{value:.4g} ({name})" for name, value in others[:2])
        emit(
            CAMERA_CALIBRATION_CONTRADICTORY.warning(
                "it states different baselines, {length:.4g} ({name}) and {others}; the first one is used",
                path,
                remedy="scan.baseline=METRES overrides it",
                length=length,
                name=taken,
                others=shown,
            )
        )
    left, right = rig.left.fx, rig.right.fx
    if not 1 / _MAX_FOCAL_RATIO < left / right < _MAX_FOCAL_RATIO:
        emit(
            CAMERA_CALIBRATION_CONTRADICTORY.warning(
                "the focal lengths of its two cameras differ, {left:.4g} and {right:.4g} px. Is one "
                "of them for another image size?",
                path,
                left=left,
                right=right,
            )
        )


def warn_not_rectified(rig: StereoRig, path: Path) -> None:
    """Warn that cameras declared as rectified are rotated or distorted."""
    emit(
        CAMERA_CALIBRATION_CONTRADICTORY.warning(
            "it declares rectified images, but its cameras are not rectified (rotated by "
            "{turn:.2g}° to each other{distortion})",
            path,
            remedy="set rectified to false in the file to rectify the images in scanloom",
            turn=_compute_rotation_deg(rig.right_from_left),
            distortion=", with distortion" if any(rig.left.distortion + rig.right.distortion) else "",
        )
    )


def check_extrinsics(first: Pose, second: Pose, names: str, path: Path) -> None:
    """Warn if two extrinsics of the same cameras differ; the first is used.

    Parameters
    ----------
    first, second : (4, 4) poses in the same unit.
    names : keys of both in the file, for the message.
    """
    lengths = [float(np.linalg.norm(pose[:3, 3])) for pose in (first, second)]
    apart = float(np.linalg.norm(first[:3, 3] - second[:3, 3]))
    turn = _compute_rotation_deg(np.linalg.inv(first) @ second)
    if apart > _LENGTH_TOLERANCE * max(lengths) or turn > _ROTATION_TOLERANCE_DEG:
        emit(
            CAMERA_CALIBRATION_CONTRADICTORY.warning(
                "its extrinsics {names} differ by {apart:.3g} in position and {turn:.2g}° in "
                "rotation; the first one is used",
                path,
                names=names,
                apart=apart,
                turn=turn,
            )
        )


def check_camera(values: dict[str, Any], camera: Camera, path: Path) -> None:
    """Warn about contradicting focal lengths and implausible fx / fy.

    Parameters
    ----------
    values : table of the camera.
    camera : camera created from the table, for the image size that the table states.
    """
    if not 1 / _MAX_FOCAL_RATIO < camera.fx / camera.fy < _MAX_FOCAL_RATIO:
        emit(
            CAMERA_CALIBRATION_CONTRADICTORY.warning(
                "its focal lengths, {fx:.4g} px horizontally and {fy:.4g} px vertically, are "
                "implausible. Are its numbers in the order fx, fy, cx, cy?",
                path,
                fx=camera.fx,
                fy=camera.fy,
            )
        )
    stated = values.get("fx")
    if not isinstance(stated, (int, float)) or not any(name in values for name in MATRIX_KEYS):
        return
    if abs(stated - camera.fx) > _FOCAL_TOLERANCE * camera.fx:
        emit(
            CAMERA_CALIBRATION_CONTRADICTORY.warning(
                "it states different focal lengths, {by_matrix:.6g} px (matrix) and {stated:.6g} px "
                "(fx); the first one is used",
                path,
                by_matrix=camera.fx,
                stated=stated,
            )
        )


def _find_baselines(
    document: dict[str, Any], values: dict[str, Any], path: Path
) -> Iterator[tuple[str, float]]:
    """Yield (key, baseline) for each baseline in the file, in its unit.

    Unreadable values are skipped.
    """
    for name in ("T", "translation", "t"):
        if name in values and (shift := _try_read_matrix(values, name, path)) is not None and shift.size == 3:
            yield name, float(np.linalg.norm(shift))
            break
    for name, table in (("P2", document.get("P2")), ("RIGHT.P", document.get("RIGHT.P"))):
        if table is not None and (projection := _try_read_matrix(document, name, path)) is not None:
            yield from _find_projection_baseline(name, projection)
    for name in ("baseline", "Stereo.b"):
        if isinstance(document.get(name), (int, float)):
            yield name, abs(float(document[name]))
    strength, focal = document.get("Camera.bf"), document.get("Camera.fx", document.get("Camera1.fx"))
    if isinstance(strength, (int, float)) and isinstance(focal, (int, float)) and focal:
        yield "Camera.bf", abs(strength / focal)


def _find_projection_baseline(name: str, projection: np.ndarray[Any, Any]) -> Iterator[tuple[str, float]]:
    is_filled = projection.shape == (3, 4) and projection[0, 0] not in (0, _IDENTITY_FOCAL)
    if is_filled and projection[0, 3]:
        yield name, abs(float(projection[0, 3] / projection[0, 0]))


def _try_read_matrix(values: dict[str, Any], name: str, path: Path) -> np.ndarray[Any, Any] | None:
    try:
        return get_matrix(values, name, path)
    except InputError:
        return None


def _is_same_length(value: float, length: float) -> bool:
    return any(
        abs(value * one / (length * other) - 1) <= _LENGTH_TOLERANCE
        for one in _UNIT_FACTORS
        for other in _UNIT_FACTORS
    )


def _compute_rotation_deg(pose: Pose) -> float:
    return math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(pose[:3, :3])) - 1) / 2))))
