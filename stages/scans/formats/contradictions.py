"""Numbers of one calibration that contradict each other: told, with the one that is taken."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from stages.diagnostics.errors import InputError
from stages.files.telling import tell
from stages.scans.formats.table_values import MATRICES, matrix_in
from stages.scans.scan import Camera, Pose, StereoRig

# Files round, and fx of a rectified pair is not quite that of its camera.
_SAME_LENGTH = 0.02
_SAME_FOCAL_LENGTH = 0.01
# What one length in metres is in another unit of the same file.
_UNITS = (1.0, 100.0, 1000.0)
# Cameras of one pair, and the two axes of one camera, have focal lengths that are nearer than so.
_ALIKE = 1.25
# A matrix that nobody filled in.
_NOT_FILLED_IN = 1.0
_SAME_TURN_DEG = 0.5


def tell_of_rig(
    document: dict[str, Any], values: dict[str, Any], rig: StereoRig, length: float, path: Path
) -> None:
    """Tell where a calibration states how its cameras stand to each other twice, and differently.

    Parameters
    ----------
    document, values : as it is written, and under the names of our own calibrations.
    rig : that was made of it.
    length : the baseline that is taken, in the unit of the file.
    """
    found = list(_baselines(document, values, path))
    others = [(name, value) for name, value in found if not _is_length(value, length)]
    if others:
        taken = next((name for name, value in found if _is_length(value, length)), "R and T")
        shown = " and ".join(f"{value:.4g} ({name})" for name, value in others[:2])
        tell(
            f"states more than one baseline, {length:.4g} ({taken}) and {shown}: the first is taken; "
            "scan.baseline=METRES states another",
            path,
        )
    left, right = rig.left.fx, rig.right.fx
    if not 1 / _ALIKE < left / right < _ALIKE:
        tell(
            f"has focal lengths of {left:.4g} and {right:.4g} px for the two cameras of a pair: is one for "
            "another size of the images?",
            path,
        )


def tell_of_rectified(rig: StereoRig, path: Path) -> None:
    """Tell that images are said to be rectified, and cameras that differ in more than their place."""
    turn = _degrees(rig.right_from_left)
    bent = ", with distortion" if any(rig.left.distortion + rig.right.distortion) else ""
    tell(
        f"says that its images are rectified, but its cameras are not those of rectified ones (turned by "
        f"{turn:.2g}° to each other{bent}): rectified=false has them rectified here",
        path,
    )


def tell_of_two_relations(first: Pose, second: Pose, names: str, path: Path) -> None:
    """Tell where two relations of the same cameras, of which the first is taken, are not one."""
    lengths = [float(np.linalg.norm(pose[:3, 3])) for pose in (first, second)]
    apart = float(np.linalg.norm(first[:3, 3] - second[:3, 3]))
    turn = _degrees(np.linalg.inv(first) @ second)
    if apart > _SAME_LENGTH * max(lengths) or turn > _SAME_TURN_DEG:
        tell(
            f"states by {names} how its cameras stand to each other, and they differ by {apart:.3g} and "
            f"{turn:.2g}°: the first is taken",
            path,
        )


def tell_of_camera(values: dict[str, Any], camera: Camera, path: Path) -> None:
    """Tell where the table of a camera states a focal length twice, or one that no lens has.

    Parameters
    ----------
    camera : that was made of it, for the images' size that it states.
    """
    if not 1 / _ALIKE < camera.fx / camera.fy < _ALIKE:
        tell(
            f"has focal lengths of {camera.fx:.4g} px across and {camera.fy:.4g} px down, which no lens has: "
            "are its numbers in the order fx, fy, cx, cy?",
            path,
        )
    stated = values.get("fx")
    if not isinstance(stated, (int, float)) or not any(name in values for name in MATRICES):
        return
    if abs(stated - camera.fx) > _SAME_FOCAL_LENGTH * camera.fx:
        tell(
            f"states the focal lengths {camera.fx:.6g} px, by its matrix, and {stated:.6g} px, by fx: the "
            "first is taken",
            path,
        )


def _baselines(document: dict[str, Any], values: dict[str, Any], path: Path) -> Iterator[tuple[str, float]]:
    """Yield each baseline that is stated, and where, in the unit of the file; what cannot be read is none."""
    for name in ("T", "translation", "t"):
        if name in values and (shift := _numbers(values, name, path)) is not None and shift.size == 3:
            yield name, float(np.linalg.norm(shift))
            break
    for name, table in (("P2", document.get("P2")), ("RIGHT.P", document.get("RIGHT.P"))):
        if table is not None and (projection := _numbers(document, name, path)) is not None:
            yield from _of_projection(name, projection)
    for name in ("baseline", "Stereo.b"):
        if isinstance(document.get(name), (int, float)):
            yield name, abs(float(document[name]))
    strength, focal = document.get("Camera.bf"), document.get("Camera.fx", document.get("Camera1.fx"))
    if isinstance(strength, (int, float)) and isinstance(focal, (int, float)) and focal:
        yield "Camera.bf", abs(strength / focal)


def _of_projection(name: str, projection: np.ndarray[Any, Any]) -> Iterator[tuple[str, float]]:
    is_filled = projection.shape == (3, 4) and projection[0, 0] not in (0, _NOT_FILLED_IN)
    if is_filled and projection[0, 3]:
        yield name, abs(float(projection[0, 3] / projection[0, 0]))


def _numbers(values: dict[str, Any], name: str, path: Path) -> np.ndarray[Any, Any] | None:
    try:
        return matrix_in(values, name, path)
    except InputError:
        return None


def _is_length(value: float, length: float) -> bool:
    return any(abs(value * one / (length * other) - 1) <= _SAME_LENGTH for one in _UNITS for other in _UNITS)


def _degrees(pose: Pose) -> float:
    return math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(pose[:3, :3])) - 1) / 2))))
