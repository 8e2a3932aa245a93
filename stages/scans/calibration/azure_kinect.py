"""Factory calibration of an Azure Kinect (`CalibrationInformation`), from recordings and tools.

Lengths are ratios of the sensor's sides. Each depth mode bins and crops the sensor; 16:9 colour images are a
central crop of the 4:3 images (Azure Kinect Sensor SDK, `calibration` and `transformation`). Pixel centres
are integers in this module, and half-integers in the SDK.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration.table_values import flatten_numbers
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID
from scanloom.stages.scans.model.poses import check_rigid_pose
from scanloom.stages.scans.model.scan import Camera, Pose

_DOCUMENT = "CalibrationInformation"
_DEPTH, _COLOR = "CALIBRATION_CameraLocationD0", "CALIBRATION_CameraLocationPV0"
# Depth modes by image size: size of the binned sensor, and offset of the crop, pixels.
_DEPTH_MODES = {
    (640, 576): ((1024, 1024), (192, 180)),
    (320, 288): ((512, 512), (96, 90)),
    (512, 512): ((512, 512), (0, 0)),
    (1024, 1024): ((1024, 1024), (0, 0)),
}
_PARAMETER_COUNT = 14


def is_azure_kinect(values: dict[str, Any]) -> bool:
    """Return True if a document is an Azure Kinect calibration."""
    return isinstance(values.get(_DOCUMENT), dict)


def to_calibration_table(values: dict[str, Any], width: int, height: int, path: Path) -> dict[str, Any]:
    """Convert the camera for an image size to scanloom's calibration keys.

    The depth camera is used for the sizes of depth modes. Other sizes belong to the colour camera: the depth
    maps were then reprojected to colour.

    Raises
    ------
    InputError
        If the camera is missing, has another lens model, or has no images of this aspect ratio.
    """
    if (width, height) in _DEPTH_MODES:
        (sensor_width, sensor_height), (left, top) = _DEPTH_MODES[width, height]
        name = _DEPTH
    else:
        sensor_width, sensor_height, left, top = (
            width,
            round(width * 3 / 4),
            0,
            (round(width * 3 / 4) - height) // 2,
        )
        name = _COLOR
        if height not in (sensor_height, round(width * 9 / 16)):
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                "an Azure Kinect has no images of {width}×{height} px; were they cropped or rotated?",
                path,
                width=width,
                height=height,
            )
    intrinsics = _find_camera(values, name, path).get("Intrinsics")
    row = flatten_numbers(
        intrinsics.get("ModelParameters") if isinstance(intrinsics, dict) else None, name, path
    )
    if len(row) != _PARAMETER_COUNT:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "{name} has {row_count} ModelParameters; {parameters} are expected.",
            path,
            name=name,
            row_count=len(row),
            parameters=_PARAMETER_COUNT,
        )
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = row
    return {
        "width": width,
        "height": height,
        "fx": fx * sensor_width,
        "fy": fy * sensor_height,
        "cx": cx * sensor_width - left - 0.5,
        "cy": cy * sensor_height - top - 0.5,
        "distortion": [k1, k2, p1, p2, k3, k4, k5, k6],
    }


def read_color_from_depth(path: Path, depth: Camera) -> Pose | None:
    """Read color_from_depth (4, 4) in metres from a calibration file.

    Returns None for other files, and if the depth maps are already aligned to colour.

    Raises
    ------
    InputError
        If the extrinsics are missing or not rigid.
    """
    if (depth.width, depth.height) not in _DEPTH_MODES or path.suffix != ".json":
        return None
    values = documents.read_document(path)
    if not is_azure_kinect(values):
        return None
    extrinsics = _find_camera(values, _COLOR, path).get("Rt")
    if not isinstance(extrinsics, dict):
        raise InputError(CAMERA_CALIBRATION_INVALID, "{color} has no extrinsics (Rt).", path, color=_COLOR)
    rotation, translation = (
        flatten_numbers(extrinsics.get(key), key, path) for key in ("Rotation", "Translation")
    )
    if (len(rotation), len(translation)) != (9, 3):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the Rt of {color} must be a rotation of 9 numbers and a translation of 3.",
            path,
            color=_COLOR,
        )
    return check_rigid_pose(np.column_stack([np.reshape(rotation, (3, 3)), translation]), path, _COLOR)


def _find_camera(values: dict[str, Any], name: str, path: Path) -> dict[str, Any]:
    """Find a camera of the document by its location name."""
    cameras = values[_DOCUMENT].get("Cameras")
    tables = [one for one in cameras if isinstance(one, dict)] if isinstance(cameras, list) else []
    found = next((one for one in tables if one.get("Location") == name), None)
    if found is None:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "its {document} has no camera {name}.",
            path,
            document=_DOCUMENT,
            name=name,
        )
    return found
