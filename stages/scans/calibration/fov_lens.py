"""Conversion of the field-of-view (FOV) lens model to OpenCV's fisheye model.

The models differ by less than 0.1 px. A ray at angle t from the optical axis is imaged at radius
f · atan(2 tan(t) tan(omega / 2)) / omega (Devernay and Faugeras, Straight lines have to be straight, Machine
Vision and Applications 13, 2001, equation 13).
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID, CAMERA_LENS_UNKNOWN
from scanloom.stages.scans.model.scan import Camera

# Radians; a smaller omega is a pinhole camera, and a larger one is not a lens.
_MIN_OMEGA_RAD, _MAX_OMEGA_RAD = 1e-3, math.pi - 1e-3
_TOLERANCE_PX = 0.1
_RAY_COUNT = 500


def convert_fov_to_fisheye(camera: Camera, omega: float, path: Path) -> Camera:
    """Fit OpenCV's fisheye model to a camera of the field-of-view model.

    The coefficients are fitted to the rays within the image of a pinhole camera of the same size and scale.

    Parameters
    ----------
    camera : image size, focal lengths and principal point of the FOV model, pixels.
    omega : parameter of the FOV model, radians.
    path : file for messages.

    Raises
    ------
    InputError
        If omega is implausible, or the fit deviates by 0.1 px or more.
    """
    if abs(omega) < _MIN_OMEGA_RAD:
        return camera
    if not 0 < omega < _MAX_OMEGA_RAD:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "omega {omega:g} of the FOV lens is implausible; it must be an angle in radians.",
            path,
            omega=omega,
        )
    scale = 2 * math.tan(omega / 2) / omega
    fx, fy = camera.fx * scale, camera.fy * scale
    corner = max(camera.cx, camera.width - camera.cx) / fx, max(camera.cy, camera.height - camera.cy) / fy
    angles = np.linspace(1e-3, math.atan(math.hypot(*corner)), _RAY_COUNT)
    radii = np.arctan(omega * scale * np.tan(angles)) / (omega * scale)
    powers = angles[:, None] ** np.array((3, 5, 7, 9))
    coefficients = np.linalg.lstsq(powers, radii - angles, rcond=None)[0]
    error = max(fx, fy) * float(np.abs(angles + powers @ coefficients - radii).max())
    if not error < _TOLERANCE_PX:
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            (
                "the FOV lens (omega {omega:g}) cannot be converted to OpenCV's fisheye model: the "
                "error is {error:.2g} px. Undistort the images with COLMAP's image_undistorter and "
                "give the folder it writes."
            ),
            path,
            omega=omega,
            error=error,
        )
    return replace(camera, fx=fx, fy=fy, distortion=tuple(map(float, coefficients)), fisheye=True)
