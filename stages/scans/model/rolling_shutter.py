"""Rolling shutter correction for a camera that rotates during readout.

The rows of an image are read one after the other, so rotation shears and stretches the image.
`Frame.shutter_turn` is the rotation from the first to the last row. The frame's pose is the pose at the
middle row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import Camera, Frame

# Pixels between nodes of the map; the map is smooth and interpolated linearly between them.
_NODE_SPACING_PX = 8
# Fixed-point iterations: the readout time depends on the row, and the row on the readout time. Each iteration
# reduces the error to a tenth.
_ITERATIONS = 4


def compute_readout_time(
    rows: NDArray[np.floating], height: float | NDArray[np.floating]
) -> NDArray[np.float64]:
    """Compute the relative readout time of rows.

    The first row has -0.5, the middle row 0 and the last row 0.5, in units of the readout time of the image.
    """
    return np.asarray((rows + 0.5) / height - 0.5, np.float64)


def get_color_shutter_turn(frame: Frame) -> NDArray[np.float64] | None:
    """Return the rotation of the colour camera during readout, in its own axes.

    (3,) rotation vector, radians; None if it is not known.
    """
    if frame.shutter_turn is None or frame.color_from_depth is None or frame.color_camera is None:
        return frame.shutter_turn
    return np.asarray(frame.color_from_depth[:3, :3] @ frame.shutter_turn)


def compute_readout_map(
    camera: Camera, turn: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Compute the sampling map that removes rolling shutter and lens distortion.

    Sampling the image there gives the view of a pinhole camera with the same matrix at the middle row's pose.

    Parameters
    ----------
    camera : camera for the image size.
    turn : (3,) rotation vector during readout, radians, in camera axes.

    Returns
    -------
    Per output pixel, (h, w) float32 each: column and row in the image, and the ratio of depth at the row's
    readout time to depth at the middle row's pose.
    """
    import cv2

    nodes = [
        (np.arange(-1, -(-size // _NODE_SPACING_PX) + 1) + 0.5) * _NODE_SPACING_PX - 0.5
        for size in (camera.width, camera.height)
    ]
    across, down = np.meshgrid(*nodes)
    rays = np.stack([(across - camera.cx) / camera.fx, (down - camera.cy) / camera.fy], axis=-1)
    rays = np.concatenate([rays, np.ones((*across.shape, 1))], axis=-1).reshape(-1, 3)
    rows, rays_at_readout, pixels = down.ravel(), rays, rays[:, :2]
    for _ in range(_ITERATIONS):
        readout_time = np.clip(compute_readout_time(rows, camera.height), -0.5, 0.5)
        rays_at_readout = _rotate_rays(rays, -readout_time[:, None] * turn)
        pixels = _project_distorted(rays_at_readout, camera)
        rows = pixels[:, 1]
    coarse = (
        np.concatenate([pixels, rays_at_readout[:, 2:]], axis=1).reshape(*across.shape, 3).astype(np.float32)
    )
    # cv2.resize aligns pixel centres, so the grid has an extra node at each border, cropped here.
    size = (_NODE_SPACING_PX * across.shape[1], _NODE_SPACING_PX * across.shape[0])
    fine = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
    fine = fine[
        _NODE_SPACING_PX : _NODE_SPACING_PX + camera.height,
        _NODE_SPACING_PX : _NODE_SPACING_PX + camera.width,
    ]
    columns, rows, depth_ratio = (np.ascontiguousarray(fine[:, :, axis], np.float32) for axis in range(3))
    return columns, rows, depth_ratio


def _rotate_rays(rays: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(turns).apply(rays))


def _project_distorted(rays: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Project rays (n, 3) to pixels (n, 2) with lens distortion."""
    import cv2

    none, coefficients = np.zeros(3), np.array(camera.distortion or (0.0,) * 4)
    of = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
    pixels = of(rays[:, None], none, none, camera.matrix, coefficients)[0]
    return np.asarray(pixels, np.float64).reshape(-1, 2)
