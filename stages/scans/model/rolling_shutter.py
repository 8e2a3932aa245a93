"""Rolling shutters: rows are read one after the other, and images are put right as if all had been at once.

A camera that turns meanwhile shows the scene sheared and stretched. `Frame.shutter_turn` is by how much it
turns from the first row to the last one; its pose is that at the middle row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import Camera, Frame

# Pixels between those whose place is worked out; in between it changes evenly.
_STEP = 8
# Where a row is read decides what it shows, and the other way round; each round leaves a tenth of the error.
_ROUNDS = 4


def late_at(rows: NDArray[np.floating], height: float | NDArray[np.floating]) -> NDArray[np.float64]:
    """Return how late rows of images of a height are read: -0.5 for the first one, 0.5 for the last.

    In shares of the time that all take, from the middle row on.
    """
    return np.asarray((rows + 0.5) / height - 0.5, np.float64)


def turn_of_color(frame: Frame) -> NDArray[np.float64] | None:
    """Return how a frame's colour camera turns while rows are read, in its own axes; None if it does not."""
    if frame.shutter_turn is None or frame.color_from_depth is None or frame.color_camera is None:
        return frame.shutter_turn
    return np.asarray(frame.color_from_depth[:3, :3] @ frame.shutter_turn)


def as_read(
    camera: Camera, turn: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return where images have what a pinhole camera with the same matrix sees from the middle row's pose.

    Parameters
    ----------
    camera : of the images' size; its distortion is taken out, too.
    turn : (3,) rotation vector, radians, in the camera's axes.

    Returns
    -------
    Of each pixel (h, w) the column and the row, and depth as that row is read over depth from that pose.
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
        late = np.clip(late_at(rows, camera.height), -0.5, 0.5)
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
