"""Cameras as RealSense's library names their numbers, and as programs beside it write them down.

fx fy ppx ppy, coeffs, model, width, height      of a stream
depth_scale                                      metres of a depth map's unit, 0.001
"""

from __future__ import annotations

from typing import Any

# Whatever the name says, the maker's own library projects these like OpenCV, to thousandths of a pixel.
_LIKE_OPENCV = ("brown conrady", "inverse brown conrady", "modified brown conrady", "plumb bob")
_NAMES = {"ppx": "cx", "ppy": "cy", "coeffs": "distortion"}
_FISHEYE, _FISHEYE_COEFFICIENTS = "kannala brandt4", 4
# Where the library's numbers of the models are written in place of their names.
_MODELS = (
    "none",
    "modified brown conrady",
    "inverse brown conrady",
    "ftheta",
    "brown conrady",
    _FISHEYE,
)


def is_like_opencv(model: str) -> bool:
    """Say whether a lens of this name bends as OpenCV's ordinary one."""
    return _plain(model) in _LIKE_OPENCV


def as_table(values: dict[str, Any]) -> dict[str, Any]:
    """Return a stream's camera under the names of our own calibrations; other tables as they are."""
    if "ppx" not in values or "ppy" not in values:
        return values
    table = {_NAMES.get(key, key): value for key, value in values.items() if key != "model"}
    model, bent = _model(values.get("model", "none")), table.get("distortion")
    if model == _FISHEYE and isinstance(bent, list):
        # Five numbers are written whatever the lens.
        return table | {"distortion_model": "equidistant", "distortion": bent[:_FISHEYE_COEFFICIENTS]}
    is_straight = not isinstance(bent, list) or not any(bent)
    return table if is_straight or model in _LIKE_OPENCV else table | {"distortion_model": model}


def _model(stated: object) -> str:
    if isinstance(stated, int) and 0 <= stated < len(_MODELS):
        return _MODELS[stated]
    return _plain(str(stated))


def _plain(model: str) -> str:
    return model.lower().removeprefix("distortion.").replace("_", " ").strip()
