"""Removal of lens distortion and rolling shutter by resampling."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.rolling_shutter import compute_readout_map
from scanloom.stages.scans.model.scan import Camera, scale_camera

_SamplingMap = NDArray[np.float32]


class SamplingMaps(NamedTuple):
    """Sampling positions in the image for each pixel of the pinhole camera, (h, w) float32 each.

    Attributes
    ----------
    columns, rows : columns and rows in the image, pixels.
    depth_ratio : ratio of depth in the image to depth of the pinhole camera; None if the ratio is 1.
    """

    columns: _SamplingMap
    rows: _SamplingMap
    depth_ratio: _SamplingMap | None = None


def compute_sampling_maps(
    camera: Camera, width: int, height: int, turn: NDArray[np.float64] | None = None
) -> SamplingMaps | None:
    """Compute the sampling maps for images of a camera at a given size.

    Returns None if the images are pinhole images already.

    Parameters
    ----------
    turn : (3,) rotation vector of the camera during readout in its own axes, radians, see
        `Frame.shutter_turn`. The output is the view from the pose at the middle row.
    """
    if turn is not None:
        return SamplingMaps(*compute_readout_map(scale_camera(camera, width, height), turn))
    return _compute_lens_maps(camera, width, height) if camera.distortion else None


def resample_to_pinhole(
    image: NDArray[Any], maps: SamplingMaps | None, *, smooth: bool, sharp: bool = False
) -> NDArray[Any]:
    """Resample an image to the pinhole camera.

    Parameters
    ----------
    image : (h, w) or (h, w, c); a float image is a depth map, and its values are converted as well.
    maps : sampling maps for its size; None returns the image unchanged.
    smooth : interpolate linearly. False takes the nearest pixel, for depth and masks.
    sharp : interpolate cubically, which preserves details.
    """
    import cv2

    if maps is None:
        return image
    interpolation = cv2.INTER_CUBIC if sharp else cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
    resampled = cv2.remap(image, maps.columns, maps.rows, interpolation)
    is_depth = resampled.dtype.kind == "f"
    return resampled / maps.depth_ratio if is_depth and maps.depth_ratio is not None else resampled


@functools.lru_cache(maxsize=4)
def _compute_lens_maps(camera: Camera, width: int, height: int) -> SamplingMaps:
    """Compute the maps of lens distortion for an image size, cached."""
    import cv2

    matrix = scale_camera(camera, width, height).matrix
    distortion = np.array(camera.distortion)
    of = cv2.fisheye.initUndistortRectifyMap if camera.fisheye else cv2.initUndistortRectifyMap
    across, down = of(matrix, distortion, np.eye(3), matrix, (width, height), cv2.CV_32FC1)
    return SamplingMaps(np.asarray(across, np.float32), np.asarray(down, np.float32))
