"""Lens distortion and rolling shutters taken out: what a pinhole camera with the same matrix sees at once."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.scans.scan import Camera, scaled

# Pixels between those whose place is worked out where a camera has turned; in between it changes evenly.
_STEP = 8
# Where a row is read decides what it shows, and the other way round; each round leaves a tenth of the error.
_ROUNDS = 4


def undistorted(
    image: NDArray[Any],
    camera: Camera,
    *,
    smooth: bool,
    sharp: bool = False,
    turn: NDArray[np.float64] | None = None,
) -> NDArray[Any]:
    """Return what a pinhole camera with the same matrix sees; depth is never averaged across an edge.

    Parameters
    ----------
    turn : (3,) of the camera from the first row to the last one, see `Frame.shutter_turn`, in its own axes;
        what is returned is seen from the middle row's pose. Floating-point images are depth, which changes
        with it; beyond what was seen it is 0.
    smooth : interpolate linearly; else the nearest pixel is taken.
    sharp : interpolate by a cubic instead, which keeps details.
    """
    import cv2

    height, width = image.shape[:2]
    if turn is None:
        across, down = _undistortion(camera, width, height)
    else:
        across, down, farther = _as_read(scaled(camera, width, height), turn)
    how = cv2.INTER_CUBIC if sharp else cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
    seen = cv2.remap(image, across, down, how)
    return seen / farther if turn is not None and seen.dtype.kind == "f" else seen


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


def _as_read(
    camera: Camera, turn: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return where images have what each pixel of the middle row's pinhole camera sees, and how far.

    Returns
    -------
    columns and rows, (h, w) pixels; and depth as its row is read over that from the middle row's pose.
    """
    import cv2

    places = [
        (np.arange(-1, -(-size // _STEP) + 1) + 0.5) * _STEP - 0.5 for size in (camera.width, camera.height)
    ]
    across, down = np.meshgrid(*places)
    rays = np.stack([(across - camera.cx) / camera.fx, (down - camera.cy) / camera.fy], axis=-1)
    rays = np.concatenate([rays, np.ones((*across.shape, 1))], axis=-1).reshape(-1, 3)
    rows, read, pixels = down.ravel(), rays, rays[:, :2]
    for _ in range(_ROUNDS):
        late = np.clip((rows + 0.5) / camera.height - 0.5, -0.5, 0.5)
        read = _turned(rays, -late[:, None] * turn)
        pixels = _distorted(read, camera)
        rows = pixels[:, 1]
    coarse = np.concatenate([pixels, read[:, 2:]], axis=1).reshape(*across.shape, 3).astype(np.float32)
    # Pixels are resized about their middles; what lies beyond the outermost ones is cut off again.
    size = (_STEP * across.shape[1], _STEP * across.shape[0])
    fine = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
    fine = fine[_STEP : _STEP + camera.height, _STEP : _STEP + camera.width]
    columns, rows, farther = (np.ascontiguousarray(fine[:, :, axis], np.float32) for axis in range(3))
    return columns, rows, farther


def _turned(rays: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(turns).apply(rays))


def _distorted(rays: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Return the (n, 2) pixels of (n, 3) rays in images with distortion."""
    import cv2

    none, coefficients = np.zeros(3), np.array(camera.distortion or (0.0,) * 4)
    of = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
    pixels = of(rays[:, None], none, none, camera.matrix, coefficients)[0]
    return np.asarray(pixels, np.float64).reshape(-1, 2)
