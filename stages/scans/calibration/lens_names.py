"""Lookup of distortion coefficients under the key names of various programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.scans.calibration.pair_names import find_distortion_pair
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED

_KNOWN_KEYS = re.compile("d|coeffs|dist(ortion)?_?(coef.*|param.*)?", re.IGNORECASE)
_SIMILAR_KEYS = re.compile("distort|coef|^dist", re.IGNORECASE)
_TERM_KEYS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE_TERM_KEYS = ("k1", "k2", "k3", "k4")


def find_distortion(values: dict[str, Any], path: Path, *, fisheye: bool) -> object:
    """Find the distortion coefficients in the table of a camera.

    Coefficients are a list, or separate values `k1`, `k2` and so on. Warns about unknown keys that look like
    distortion. Returns None without coefficients.
    """
    named = {key: value for key, value in values.items() if _KNOWN_KEYS.fullmatch(str(key))}
    stated = next((value for value in named.values() if value is not None), None)
    terms = values if stated is None else stated
    if isinstance(terms, dict) and {"k1", "k2"} <= terms.keys():
        # k4 to k6 belong to the rational model.
        names = (
            _FISHEYE_TERM_KEYS
            if fisheye
            else _TERM_KEYS
            if terms.keys() & set(_TERM_KEYS[5:])
            else _TERM_KEYS[:5]
        )
        return [terms.get(name, 0.0) for name in names]
    if not named:
        _warn_unknown_keys(values, path)
    return stated


def find_pair_distortions(values: dict[str, Any], path: Path) -> tuple[object, object]:
    """Find the distortion coefficients of both cameras of a stereo pair.

    Without coefficients: (None, None), and a warning about unknown keys.
    """
    keys = find_distortion_pair(values)
    if keys is None:
        _warn_unknown_keys(values, path)
        return None, None
    return values[keys[0]], values[keys[1]]


def _warn_unknown_keys(values: dict[str, Any], path: Path) -> None:
    for key, value in values.items():
        if _SIMILAR_KEYS.search(str(key)) and isinstance(value, (list, dict)) and value:
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "the key {key} is unknown; the lens is assumed to have no distortion",
                    path,
                    key=str(key)[:40],
                )
            )
