"""ORB-SLAM settings in OpenCV's YAML, used by ORB-SLAM and related programs.

Camera.fx fy cx cy k1 k2 p1 p2 k3      or Camera1.fx …, Camera2.fx … (version 3)
Camera.width, Camera.height            image size; missing in older files
Camera.bf                              baseline × fx (nominal for RGB-D); or Stereo.b in metres
Stereo.T_c1_c2 or Tlr                  maps points from right to left camera coordinates
LEFT.K D R P, RIGHT.K D R P            unrectified stereo pair
DepthMapFactor                         units of a depth map per metre; or RGBD.DepthMapFactor
"""

from __future__ import annotations

from typing import Any

_DISTORTION_KEYS = ("k1", "k2", "p1", "p2", "k3")
_FISHEYE_KEYS = ("k1", "k2", "k3", "k4")
_FISHEYE_TYPE = "KannalaBrandt8"
# Keys of a side in ROS's camera_info, from which the settings are copied.
_SIDE_KEYS = {
    "K": "camera_matrix",
    "D": "distortion_coefficients",
    "R": "rectification_matrix",
    "P": "projection_matrix",
    "width": "width",
    "height": "height",
}
# A factor of 1 belongs to float depth and does not describe depth files.
_MIN_DEPTH_FACTOR = 1.0


def to_calibration_table(values: dict[str, Any]) -> dict[str, Any]:
    """Convert ORB-SLAM settings to scanloom's calibration keys.

    Other tables are returned unchanged. Numbers are not validated here but when the camera is created.
    """
    first = next((name for name in ("Camera1", "Camera") if f"{name}.fx" in values), None)
    if first is None:
        return values
    table = _convert_camera(values, first)
    factor = values.get("DepthMapFactor", values.get("RGBD.DepthMapFactor"))
    if isinstance(factor, (int, float)) and factor > _MIN_DEPTH_FACTOR:
        table["depth_scale"] = factor
    if all(f"{side}.{key}" in values for side in ("LEFT", "RIGHT") for key in ("K", "P")):
        return table | {side.lower(): _convert_side(values, side) for side in ("LEFT", "RIGHT")}
    if "Stereo.b" in values:
        table["baseline"] = values["Stereo.b"]
    elif (
        "Camera.bf" in values and (baseline := _divide_or_none(values["Camera.bf"], table["fx"])) is not None
    ):
        table["baseline"] = baseline
    relation = values.get("Stereo.T_c1_c2", values.get("Tlr"))
    if relation is not None and "Camera2.fx" in values:
        table |= {"left": _convert_camera(values, first), "right": _convert_camera(values, "Camera2")}
        table["left_from_right"] = relation
    return table


def _convert_camera(values: dict[str, Any], name: str) -> dict[str, Any]:
    table = {key: values[f"{name}.{key}"] for key in ("fx", "fy", "cx", "cy") if f"{name}.{key}" in values}
    table |= {key: values[f"Camera.{key}"] for key in ("width", "height") if f"Camera.{key}" in values}
    is_fisheye = values.get("Camera.type") == _FISHEYE_TYPE
    bent = [values.get(f"{name}.{key}", 0.0) for key in (_FISHEYE_KEYS if is_fisheye else _DISTORTION_KEYS)]
    return table | {"distortion": bent} | ({"distortion_model": "equidistant"} if is_fisheye else {})


def _convert_side(values: dict[str, Any], side: str) -> dict[str, Any]:
    return {name: values[f"{side}.{key}"] for key, name in _SIDE_KEYS.items() if f"{side}.{key}" in values}


def _divide_or_none(first: object, second: object) -> float | None:
    if not isinstance(first, (int, float)) or not isinstance(second, (int, float)):
        return None
    try:
        return first / second
    except (OverflowError, ZeroDivisionError):
        return None
