"""Files with the correction of a sensor's depth: depth_calibration.json of `adjust`.

{
"version": 1,
"width": 640, "height": 480,     size of the depth maps, pixels
"near_m": 0.8, "far_m": 2.9,     depth range of the estimate, metres
"coefficients": […]              30 values, see stages/scans/model/depth_correction.py
}
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID, CAMERA_CALIBRATION_MISMATCH
from scanloom.stages.scans.model.depth_correction import COEFFICIENT_COUNT, DepthCorrection
from scanloom.stages.scans.model.scan import Frame, Scan

DEPTH_CALIBRATION_FILE = "depth_calibration.json"
FORMAT_VERSION = 1
# Maximum absolute coefficient; sensors bend depth by a few percent.
_MAX_COEFFICIENT = 0.5
_MAX_DEPTH_M = 1e4
_MAX_CORRECTION_PERCENT = 50
# Maximum relative difference of the aspect ratios of calibration and depth maps.
_ASPECT_TOLERANCE = 0.02


def write_depth_calibration(path: Path, correction: DepthCorrection) -> None:
    """Write a correction as JSON."""
    text = json.dumps(to_depth_calibration_table(correction), indent=1)
    path.write_text(text + "\n", encoding="utf-8", newline="\n")


def read_depth_calibration(path: Path) -> DepthCorrection:
    """Read a correction from a JSON file.

    Raises
    ------
    InputError
        If the file cannot be read or is not a depth calibration.
    """
    return parse_depth_calibration(documents.read_json(path), path)


def to_depth_calibration_table(correction: DepthCorrection) -> dict[str, Any]:
    """Convert a correction to a JSON object."""
    return {
        "version": FORMAT_VERSION,
        "width": correction.width,
        "height": correction.height,
        "near_m": correction.near_m,
        "far_m": correction.far_m,
        "coefficients": list(correction.coefficients),
    }


def parse_depth_calibration(table: object, path: Path) -> DepthCorrection:
    """Parse the JSON object of a correction.

    Raises
    ------
    InputError
        If a value is missing or invalid.
    """
    if not isinstance(table, dict) or "coefficients" not in table or "near_m" not in table:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "a depth_calibration.json of `scanloom adjust` is expected.",
            path,
        )
    if table.get("version") != FORMAT_VERSION:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "unsupported version of a depth calibration: {found!r}; version {known} is expected.",
            path,
            found=table.get("version"),
            known=FORMAT_VERSION,
        )
    width: Any = table.get("width")
    height: Any = table.get("height")
    if not _is_size(width) or not _is_size(height):
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "a depth calibration needs width and height in pixels.", path
        )
    near: Any = table.get("near_m")
    far: Any = table.get("far_m")
    if not _is_number(near) or not _is_number(far) or not 0 < near < far <= _MAX_DEPTH_M:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "a depth calibration needs 0 < near_m < far_m, in metres.",
            path,
        )
    values = table["coefficients"]
    if (
        not isinstance(values, list)
        or len(values) != COEFFICIENT_COUNT
        or not all(_is_number(value) and abs(value) <= _MAX_COEFFICIENT for value in values)
    ):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "a depth calibration needs {count} coefficients between -{limit} and {limit}.",
            path,
            count=COEFFICIENT_COUNT,
            limit=_MAX_COEFFICIENT,
        )
    correction = DepthCorrection(width, height, float(near), float(far), tuple(map(float, values)))
    low, high = correction.compute_range_percent()
    if max(-low, high) > _MAX_CORRECTION_PERCENT:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "it changes depth by {low:.0f} to {high:.0f} %, and at most {limit} % are plausible.",
            path,
            low=low,
            high=high,
            limit=_MAX_CORRECTION_PERCENT,
        )
    return correction


def apply_depth_calibration(scan: Scan, path: Path) -> Scan:
    """Apply the depth calibration of a sensor to the frames of a scan.

    Raises
    ------
    InputError
        If the file is invalid, or the depth maps have another aspect ratio than its size.
    """
    correction = read_depth_calibration(path)
    frames = [_apply_to_frame(frame, correction, path) for frame in scan.frames]
    return replace(scan, frames=frames)


def _apply_to_frame(frame: Frame, correction: DepthCorrection, path: Path) -> Frame:
    if frame.depth is None:
        return frame
    camera = frame.camera
    aspect = camera.width * correction.height / (camera.height * correction.width)
    if abs(aspect - 1) > _ASPECT_TOLERANCE:
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "the depth calibration is for depth maps of {width} × {height} px, but frame {name} has "
                "{camera_width} × {camera_height} px."
            ),
            path,
            width=correction.width,
            height=correction.height,
            name=frame.name,
            camera_width=camera.width,
            camera_height=camera.height,
        )
    return replace(frame, depth_correction=correction)


def _is_size(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= 1 << 16


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _MAX_DEPTH_M
