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


def is_like_opencv(model: str) -> bool:
    """Say whether a lens of this name bends as OpenCV's ordinary one."""
    return _plain(model) in _LIKE_OPENCV


def as_table(values: dict[str, Any]) -> dict[str, Any]:
    """Return a stream's camera under the names of our own calibrations; other tables as they are."""
    if "ppx" not in values or "ppy" not in values:
        return values
    table = {_NAMES.get(key, key): value for key, value in values.items() if key != "model"}
    model = _plain(str(values.get("model", "none")))
    bent = table.get("distortion")
    if model == _FISHEYE and isinstance(bent, list):
        # Five numbers are written whatever the lens.
        return table | {"distortion_model": "equidistant", "distortion": bent[:_FISHEYE_COEFFICIENTS]}
    if model != "none" and model not in _LIKE_OPENCV:
        table["distortion_model"] = model
    return table


def _plain(model: str) -> str:
    return model.lower().removeprefix("distortion.").replace("_", " ").strip()
