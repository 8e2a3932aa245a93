"""Lens distortion and rolling shutters taken out: what a pinhole camera with the same matrix sees at once."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.rolling_shutter import as_read
from scanloom.stages.scans.model.scan import Camera, scaled

_Map = NDArray[np.float32]


class Maps(NamedTuple):
    """Where images have what each pixel of the pinhole camera sees, (h, w) each.

    Attributes
    ----------
    across, down : columns and rows, pixels.
    farther : depth there over that of the pinhole camera; None where it is the same.
    """

    across: _Map
    down: _Map
    farther: _Map | None = None


def maps_of(camera: Camera, width: int, height: int, turn: NDArray[np.float64] | None = None) -> Maps | None:
    """Return the maps for a camera's images of a size; None where these are what a pinhole camera sees.

    Parameters
    ----------
    turn : (3,) of the camera while its rows are read, in its own axes, see `Frame.shutter_turn`: what is seen
        is seen from the pose at the middle row.
    """
    if turn is not None:
        return Maps(*as_read(scaled(camera, width, height), turn))
    return _undistortion(camera, width, height) if camera.distortion else None


def undistorted(image: NDArray[Any], maps: Maps | None, *, smooth: bool, sharp: bool = False) -> NDArray[Any]:
    """Return what the pinhole camera sees; depth is never averaged across an edge.

    Parameters
    ----------
    image : as it was taken; depth if its values are no integers.
    maps : for its size; as None it stays as it is.
    smooth : interpolate linearly; else the nearest pixel is taken.
    sharp : interpolate by a cubic instead, which keeps details.
    """
    import cv2

    if maps is None:
        return image
    how = cv2.INTER_CUBIC if sharp else cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
    seen = cv2.remap(image, maps.across, maps.down, how)
    is_depth = seen.dtype.kind == "f"
    return seen / maps.farther if is_depth and maps.farther is not None else seen


@functools.lru_cache(maxsize=4)
def _undistortion(camera: Camera, width: int, height: int) -> Maps:
    """Return the maps for images of a size, the camera's matrix scaled to it."""
    import cv2

    matrix = scaled(camera, width, height).matrix
    distortion = np.array(camera.distortion)
    of = cv2.fisheye.initUndistortRectifyMap if camera.fisheye else cv2.initUndistortRectifyMap
    across, down = of(matrix, distortion, np.eye(3), matrix, (width, height), cv2.CV_32FC1)
    return Maps(np.asarray(across, np.float32), np.asarray(down, np.float32))
