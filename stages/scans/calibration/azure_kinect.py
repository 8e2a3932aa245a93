"""The factory calibration of an Azure Kinect, as its recordings and tools hold it (`CalibrationInformation`).

Lengths are shares of the sensor's sides. A mode of depth bins the sensor's pixels and takes a part of them;
pictures of 16:9 are the middle of those of 4:3 (Azure Kinect Sensor SDK, `calibration` and `transformation`).
Pixels' middles are whole numbers here, halves there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration.table_values import number_row
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID
from scanloom.stages.scans.model.poses import rigid
from scanloom.stages.scans.model.scan import Camera, Pose

_DOCUMENT = "CalibrationInformation"
_DEPTH, _COLOR = "CALIBRATION_CameraLocationD0", "CALIBRATION_CameraLocationPV0"
# By the size of depth maps: the sides of the sensor as binned, and where the maps begin on it.
_MODES = {
    (640, 576): ((1024, 1024), (192, 180)),
    (320, 288): ((512, 512), (96, 90)),
    (512, 512): ((512, 512), (0, 0)),
    (1024, 1024): ((1024, 1024), (0, 0)),
}
_PARAMETERS = 14


def is_one(values: dict[str, Any]) -> bool:
    """Say whether a document is such a calibration."""
    return isinstance(values.get(_DOCUMENT), dict)


def as_table(values: dict[str, Any], width: int, height: int, path: Path) -> dict[str, Any]:
    """Return the camera that takes images of this size under the names of our own calibrations.

    Of sizes that no mode of depth has it is that of colour: depth maps have then been brought to it.

    Raises
    ------
    InputError
        If the camera is missing, has other parameters, or takes no images of this shape.
    """
    if (width, height) in _MODES:
        (wide, high), (left, top) = _MODES[width, height]
        name = _DEPTH
    else:
        wide, high, left, top = width, round(width * 3 / 4), 0, (round(width * 3 / 4) - height) // 2
        name = _COLOR
        if height not in (high, round(width * 9 / 16)):
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                "an Azure Kinect takes no images of {width}×{height}; are they cropped or turned?",
                path,
                width=width,
                height=height,
            )
    intrinsics = _camera(values, name, path).get("Intrinsics")
    row = number_row(intrinsics.get("ModelParameters") if isinstance(intrinsics, dict) else None, name, path)
    if len(row) != _PARAMETERS:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "{name} has {row_count} ModelParameters; {parameters} are expected.",
            path,
            name=name,
            row_count=len(row),
            parameters=_PARAMETERS,
        )
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = row
    return {
        "width": width,
        "height": height,
        "fx": fx * wide,
        "fy": fy * high,
        "cx": cx * wide - left - 0.5,
        "cy": cy * high - top - 0.5,
        "distortion": [k1, k2, p1, p2, k3, k4, k5, k6],
    }


def color_from_depth(path: Path, depth: Camera) -> Pose | None:
    """Return the (4, 4) color_from_depth of a file; None if it is another, or depth is in colour's place.

    Raises
    ------
    InputError
        If the colour camera's place is no rigid motion.
    """
    if (depth.width, depth.height) not in _MODES or path.suffix != ".json":
        return None
    values = documents.read_document(path)
    if not is_one(values):
        return None
    place = _camera(values, _COLOR, path).get("Rt")
    if not isinstance(place, dict):
        raise InputError(CAMERA_CALIBRATION_INVALID, "{color} has no Rt.", path, color=_COLOR)
    turn, shift = (number_row(place.get(key), key, path) for key in ("Rotation", "Translation"))
    if (len(turn), len(shift)) != (9, 3):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the Rt of {color} is no rotation of 9 numbers and a translation of 3.",
            path,
            color=_COLOR,
        )
    return rigid(np.column_stack([np.reshape(turn, (3, 3)), shift]), path, _COLOR)


def _camera(values: dict[str, Any], name: str, path: Path) -> dict[str, Any]:
    """Return one of the cameras of a document."""
    cameras = values[_DOCUMENT].get("Cameras")
    tables = [one for one in cameras if isinstance(one, dict)] if isinstance(cameras, list) else []
    found = next((one for one in tables if one.get("Location") == name), None)
    if found is None:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "its {document} holds no camera {name}.",
            path,
            document=_DOCUMENT,
            name=name,
        )
    return found
