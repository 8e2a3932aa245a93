"""Lens distortion taken out: what a pinhole camera with the same matrix sees."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.scans.scan import Camera, scaled


def undistorted(image: NDArray[Any], camera: Camera, *, smooth: bool, sharp: bool = False) -> NDArray[Any]:
    """Return what a pinhole camera with the same matrix sees; depth is never averaged across an edge.

    Parameters
    ----------
    smooth : interpolate linearly; else the nearest pixel is taken.
    sharp : interpolate by a cubic instead, which keeps details.
    """
    import cv2

    across, down = _undistortion(camera, image.shape[1], image.shape[0])
    how = cv2.INTER_CUBIC if sharp else cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
    return cv2.remap(image, across, down, how)


@functools.lru_cache(maxsize=4)
def _undistortion(camera: Camera, width: int, height: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the maps for images of a size, the camera's matrix scaled to it."""
    import cv2

    matrix = scaled(camera, width, height).matrix
    distortion = np.array(camera.distortion)
    if camera.fisheye:
        return cv2.fisheye.initUndistortRectifyMap(
            matrix, distortion, np.eye(3), matrix, (width, height), cv2.CV_32FC1
        )
    return cv2.initUndistortRectifyMap(matrix, distortion, np.eye(3), matrix, (width, height), cv2.CV_32FC1)
