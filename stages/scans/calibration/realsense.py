"""Camera intrinsics with the key names of RealSense's library (librealsense).

fx fy ppx ppy, coeffs, model, width, height      of a stream
depth_scale                                      metres per unit of the depth map, 0.001
"""

from __future__ import annotations

from typing import Any

# librealsense projects all of these models like OpenCV, within thousandths of a pixel, regardless of the
# name.
_OPENCV_MODELS = ("brown conrady", "inverse brown conrady", "modified brown conrady", "plumb bob")
_KEY_NAMES = {"ppx": "cx", "ppy": "cy", "coeffs": "distortion"}
_FISHEYE, _FISHEYE_COEFFICIENTS = "kannala brandt4", 4
# Models by their number in librealsense, which some programs write in place of the name.
_MODEL_NAMES = (
    "none",
    "modified brown conrady",
    "inverse brown conrady",
    "ftheta",
    "brown conrady",
    _FISHEYE,
)


def is_opencv_model(model: str) -> bool:
    """Return True if a distortion model is equivalent to OpenCV's standard model."""
    return _normalise_model_name(model) in _OPENCV_MODELS


def to_calibration_table(values: dict[str, Any]) -> dict[str, Any]:
    """Convert a stream's intrinsics to scanloom's calibration keys.

    Other tables are returned unchanged.
    """
    if "ppx" not in values or "ppy" not in values:
        return values
    table = {_KEY_NAMES.get(key, key): value for key, value in values.items() if key != "model"}
    model, distortion = _get_model_name(values.get("model", "none")), table.get("distortion")
    if model == _FISHEYE and isinstance(distortion, list):
        # Files have five coefficients for every model.
        return table | {"distortion_model": "equidistant", "distortion": distortion[:_FISHEYE_COEFFICIENTS]}
    is_straight = not isinstance(distortion, list) or not any(distortion)
    return table if is_straight or model in _OPENCV_MODELS else table | {"distortion_model": model}


def _get_model_name(stated: object) -> str:
    if isinstance(stated, int) and 0 <= stated < len(_MODEL_NAMES):
        return _MODEL_NAMES[stated]
    return _normalise_model_name(str(stated))


def _normalise_model_name(model: str) -> str:
    return model.lower().removeprefix("distortion.").replace("_", " ").strip()
