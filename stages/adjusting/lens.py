"""Pinhole camera with OpenCV distortion: projection, its derivatives, and rays of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Number of supported distortion coefficients: k1, k2, p1, p2, k3.
DISTORTION_COEFFICIENT_COUNT = 5
# Fixed-point iterations of undistortion; mild lenses, as in depth cameras, converge in a few.
_UNDISTORT_ITERATIONS = 12


def project_with_distortion(points: NDArray[np.float64], lenses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project points to pixels (n, 2), with lens distortion.

    Parameters
    ----------
    points : (n, 3) metres, axes of the camera.
    lenses : (n, 9) or (9,), see `Cameras.lenses`.
    """
    x, y = (points[:, :2] / points[:, 2:]).T
    bent = _distort(x, y, lenses.T[4:])
    fx, fy, cx, cy = lenses.T[:4]
    return np.stack([fx * bent[0] + cx, fy * bent[1] + cy], axis=1)


def compute_projection_derivatives(
    points: NDArray[np.float64], lenses: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Project points to pixels, and compute the derivatives.

    Parameters
    ----------
    points : (n, 3) metres, axes of the camera.
    lenses : (n, 9) or (9,), see `Cameras.lenses`.

    Returns
    -------
    pixels : (n, 2).
    by_point : (n, 2, 3) derivatives by the point, pixels per metre.
    by_lens : (n, 2, 4) derivatives by the log of the focal length, by cx and cy (pixels), and by k1.
    """
    inverse = 1 / points[:, 2]
    x, y = points[:, 0] * inverse, points[:, 1] * inverse
    fx, fy, cx, cy = lenses.T[:4]
    k1, k2, p1, p2, k3 = lenses.T[4:]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    across, down = _distort(x, y, lenses.T[4:])
    flat = np.empty((len(points), 2, 2))
    flat[:, 0, 0] = fx * (radial + slope * x * x + 2 * p1 * y + 6 * p2 * x)
    flat[:, 0, 1] = fx * (slope * x * y + 2 * p1 * x + 2 * p2 * y)
    flat[:, 1, 0] = fy * (slope * x * y + 2 * p1 * x + 2 * p2 * y)
    flat[:, 1, 1] = fy * (radial + slope * y * y + 6 * p1 * y + 2 * p2 * x)
    by_point = np.empty((len(points), 2, 3))
    by_point[:, :, :2] = flat * inverse[:, None, None]
    by_point[:, :, 2] = -(flat[:, :, 0] * x[:, None] + flat[:, :, 1] * y[:, None]) * inverse[:, None]
    by_lens = np.zeros((len(points), 2, 4))
    by_lens[:, 0, 0], by_lens[:, 1, 0] = fx * across, fy * down
    by_lens[:, 0, 1] = by_lens[:, 1, 2] = 1
    by_lens[:, 0, 3], by_lens[:, 1, 3] = fx * x * square, fy * y * square
    return np.stack([fx * across + cx, fy * down + cy], axis=1), by_point, by_lens


def compute_rays(pixels: NDArray[np.floating], lenses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the undistorted rays (n, 3) of pixels (n, 2), with z = 1."""
    fx, fy, cx, cy = lenses.T[:4]
    across, down = (pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy
    x, y = across, down
    if lenses.T[4:].any():
        for _ in range(_UNDISTORT_ITERATIONS):
            there = _distort(x, y, lenses.T[4:])
            x, y = x + across - there[0], y + down - there[1]
    return np.stack([x, y, np.ones_like(x)], axis=1)


def _distort(
    x: NDArray[np.float64], y: NDArray[np.float64], coefficients: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    k1, k2, p1, p2, k3 = coefficients
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
        y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
    )
