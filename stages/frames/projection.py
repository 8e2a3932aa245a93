"""Projection of points to pixels and back, for pinhole cameras without lens distortion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import Camera


def project(points: NDArray[Any], camera: Camera) -> tuple[NDArray[Any], NDArray[Any]]:
    """Project points (…, 3) in camera axes to pixels.

    Returns
    -------
    Columns and rows (…) of the pixels; NaN for points that are not in front of the camera.
    """
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    return points[..., 0] / z * camera.fx + camera.cx, points[..., 1] / z * camera.fy + camera.cy


def unproject(
    columns: NDArray[Any], rows: NDArray[Any], depth: NDArray[Any] | float, camera: Camera
) -> NDArray[Any]:
    """Unproject pixels to points (…, 3) in camera axes.

    Parameters
    ----------
    columns, rows : (…) positions in the image, pixels.
    depth : (…) along the optical axis, metres; 1 for the rays of the pixels.
    """
    x = (columns - camera.cx) / camera.fx * depth
    y = (rows - camera.cy) / camera.fy * depth
    return np.stack([x, y, np.full(x.shape, depth, x.dtype)], axis=-1)
