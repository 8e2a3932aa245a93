"""Factory calibration of a ZED camera, `SN12345.conf`: both cameras per image size, and extrinsics.

    [LEFT_CAM_HD]  fx=700.5  fy=…  cx=…  cy=…  k1=…  k2=…  p1=…  p2=…  k3=…
    [RIGHT_CAM_HD] …
    [STEREO]       Baseline=119.87  TY=…  TZ=…  CV_HD=…  RX_HD=…  RZ_HD=…

Lengths are in millimetres, rotations are a rotation vector (RX, CV, RZ) in radians. Images are not rectified.
"""

from __future__ import annotations

import configparser
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.image_size import has_same_aspect_ratio
from scanloom.stages.scans.calibration.table_values import to_finite_number
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    CAMERA_CALIBRATION_MISMATCH,
    CAMERA_PAIR_UNCALIBRATED,
)

_SECTION_MARK = "[LEFT_CAM_"
_STEREO_SECTION = "STEREO"
_CAMERA_KEYS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
# (width, height) of one camera's images by mode name.
_MODE_SIZES = {
    "2K": (2208, 1242),
    "FHD": (1920, 1080),
    "FHD1200": (1920, 1200),
    "HD": (1280, 720),
    "SVGA": (960, 600),
    "VGA": (672, 376),
}


def parse_zed_text(text: str) -> dict[str, Any] | None:
    """Parse a ZED calibration into tables by section; None for other texts."""
    if _SECTION_MARK not in text.upper():
        return None
    parser = configparser.ConfigParser(strict=False, interpolation=None, inline_comment_prefixes=("#", ";"))
    try:
        parser.read_string(text)
    except configparser.Error:
        return None
    return {name.upper(): dict(parser[name]) for name in parser.sections()}


def is_zed_calibration(values: dict[str, Any]) -> bool:
    """Return True if a document is a ZED calibration."""
    return any(str(name).startswith(_SECTION_MARK[1:]) for name in values)


def to_calibration_table(values: dict[str, Any], width: int, height: int, path: Path) -> dict[str, Any]:
    """Convert the left camera for an image size to scanloom's calibration keys.

    Raises
    ------
    InputError
        If no mode has this aspect ratio, or a number is missing.
    """
    return _read_camera(values, "LEFT", _select_mode(values, width, height, path), path)


def to_rig_table(values: dict[str, Any], width: int, height: int, path: Path) -> dict[str, Any]:
    """Convert both cameras and their extrinsics to scanloom's calibration keys.

    x_right = R x_left + T, in millimetres.

    Raises
    ------
    InputError
        As `to_calibration_table`, and if a number of the extrinsics is missing.
    """
    mode = _select_mode(values, width, height, path)
    stereo = values.get(_STEREO_SECTION)
    if not isinstance(stereo, dict):
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED,
            "the section [{stereo}] with the extrinsics is missing.",
            path,
            stereo=_STEREO_SECTION,
        )
    rotation = [_read_number(stereo, (f"{name}_{mode}", name), path) for name in ("rx", "cv", "rz")]
    offsets = [_read_number(stereo, (f"{name}_{mode}", name), path, 0.0) for name in ("ty", "tz")]
    # Stereolabs' own programs align rows with this rotation and baseline direction.
    translation = [-length for length in (_read_number(stereo, ("baseline",), path), *offsets)]
    return {
        "left": _read_camera(values, "LEFT", mode, path),
        "right": _read_camera(values, "RIGHT", mode, path),
        "R": rotation,
        "T": translation,
        "unit": "mm",
        "rectified": False,
    }


def _select_mode(values: dict[str, Any], width: int, height: int, path: Path) -> str:
    """Return the mode with the size of the images.

    Otherwise a mode with the same aspect ratio.
    """
    there = [mode for mode in _MODE_SIZES if f"LEFT_CAM_{mode}" in values]
    shaped = [mode for mode in there if has_same_aspect_ratio(_MODE_SIZES[mode], (width, height))]
    found = next(
        (mode for mode in there if _MODE_SIZES[mode] == (width, height)), shaped[0] if shaped else None
    )
    if found is None:
        sizes = (
            ", ".join(f"{_MODE_SIZES[mode][0]}×{_MODE_SIZES[mode][1]}" for mode in there) or "no known size"
        )
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            "it is for images of {sizes} px, but these are {width}×{height} px.",
            path,
            sizes=sizes,
            width=width,
            height=height,
        )
    return found


def _read_camera(values: dict[str, Any], side: str, mode: str, path: Path) -> dict[str, Any]:
    name = f"{side}_CAM_{mode}"
    table = values.get(name)
    if not isinstance(table, dict):
        raise InputError(CAMERA_CALIBRATION_INVALID, "the section [{name}] is missing.", path, name=name)
    fx, fy, cx, cy, *bent = (
        _read_number(table, (key,), path, 0.0 if key[0] in "kp" else None) for key in _CAMERA_KEYS
    )
    width, height = _MODE_SIZES[mode]
    return {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": bent}


def _read_number(
    table: dict[str, Any], names: tuple[str, ...], path: Path, default: float | None = None
) -> float:
    """Return the number under the first existing name, or `default`."""
    name = next((name.lower() for name in names if name.lower() in table), None)
    if name is None:
        if default is None:
            raise InputError(CAMERA_CALIBRATION_INVALID, "{names} is missing.", path, names=names[0])
        return default
    return to_finite_number(table[name], name, path)
