"""Camera intrinsics with the key names of RealSense's library (librealsense).

fx fy ppx ppy, coeffs, model, width, height      of a stream
depth_scale                                      metres per unit of the depth map, 0.001
"""

from __future__ import annotations

from typing import Any

# librealsense projects all of these models like OpenCV, within thousandths of a pixel, regardless of the
# name.
_LIKE_OPENCV = ("brown conrady", "inverse brown conrady", "modified brown conrady", "plumb bob")
_NAMES = {"ppx": "cx", "ppy": "cy", "coeffs": "distortion"}
_FISHEYE, _FISHEYE_COEFFICIENTS = "kannala brandt4", 4
# Models by their number in librealsense, which some programs write in place of the name.
_MODELS = (
    "none",
    "modified brown conrady",
    "inverse brown conrady",
    "ftheta",
    "brown conrady",
    _FISHEYE,
)


def is_like_opencv(model: str) -> bool:
    """Return True if a distortion model is equivalent to OpenCV's standard model."""
    return _plain(model) in _LIKE_OPENCV


def as_table(values: dict[str, Any]) -> dict[str, Any]:
    """Convert a stream's intrinsics to scanloom's calibration keys.

    Other tables are returned unchanged.
    """
    if "ppx" not in values or "ppy" not in values:
        return values
    table = {_NAMES.get(key, key): value for key, value in values.items() if key != "model"}
    model, bent = _model(values.get("model", "none")), table.get("distortion")
    if model == _FISHEYE and isinstance(bent, list):
        # Files have five coefficients for every model.
        return table | {"distortion_model": "equidistant", "distortion": bent[:_FISHEYE_COEFFICIENTS]}
    is_straight = not isinstance(bent, list) or not any(bent)
    return table if is_straight or model in _LIKE_OPENCV else table | {"distortion_model": model}


def _model(stated: object) -> str:
    if isinstance(stated, int) and 0 <= stated < len(_MODELS):
        return _MODELS[stated]
    return _plain(str(stated))


def _plain(model: str) -> str:
    return model.lower().removeprefix("distortion.").replace("_", " ").strip()
