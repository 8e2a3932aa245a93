"""Read a frame's images: 8-bit RGB colour, metric float32 depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.scan import Camera, ColorImage, DepthImage, Frame


def read_color(frame: Frame) -> ColorImage | None:
    """Return the frame's colour (or left) image, (h, w, 3) uint8 RGB, at its own size; None if it has none.

    Grey images come back with three equal channels.

    Raises
    ------
    InputError
        If the file is missing, does not decode or holds other than 8 bits a channel.
    """
    return None if frame.color is None else _color(frame.color, frame.name)


def read_right(frame: Frame) -> ColorImage | None:
    """Return the frame's right image as `read_color` does the left one."""
    return None if frame.right is None else _color(frame.right, frame.name)


def read_depth(frame: Frame) -> DepthImage | None:
    """Return the frame's depth map, (h, w) float32 metres along the optical axis, 0 where missing.

    Raises
    ------
    InputError
        If the file is missing, does not decode, is an 8-bit or colour image, or its size is not the camera's.
    """
    if frame.depth is None:
        return None
    if isinstance(frame.depth, np.ndarray):
        depth = np.asarray(frame.depth, np.float32)
    else:
        depth = _depth_file(frame.depth, frame)
    require_size(depth, frame.camera, frame.depth, frame.name)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))


def require_size(image: NDArray[Any], camera: Camera, source: Path | Any, name: str) -> None:
    """Raise InputError unless the image has the size the camera was calibrated for."""
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"the image is {width}×{height}, but its camera is calibrated for {camera.width}×{camera.height}. "
            "Give images of the calibrated size, or the calibration of this size.",
            source if isinstance(source, Path) else f"frame {name}",
        )


def _color(source: Path | ColorImage, name: str) -> ColorImage:
    import cv2

    if isinstance(source, Path):
        image = _decode(source)
        if image.dtype != np.uint8:
            raise InputError(
                f"a colour image of 8 bits a channel is expected; this one is {image.dtype}.", source
            )
    else:
        image = np.asarray(source)
        if image.dtype != np.uint8 or image.ndim not in (2, 3):
            raise InputError(
                f"colour must be (h, w, 3) uint8, not {image.shape} {image.dtype}.", f"frame {name}"
            )
        if image.ndim == 3:
            return np.ascontiguousarray(image[:, :, :3])
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    code = cv2.COLOR_BGRA2RGB if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return cv2.cvtColor(image, code)


def _depth_file(path: Path, frame: Frame) -> DepthImage:
    if path.suffix == ".npy":
        try:
            raw = np.load(path, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise InputError(f"the depth map cannot be read ({error}).", path) from error
    else:
        raw = _decode(path)
    if raw.ndim != 2:
        raise InputError("a depth map of one channel is expected; this is a colour image.", path)
    if raw.dtype == np.uint8:
        raise InputError("the depth map has 8 bits a pixel; 16-bit or float depth is expected.", path)
    depth = raw.astype(np.float32) / np.float32(frame.depth_scale)
    for marker in frame.depth_missing:
        depth[raw == marker] = 0
    return depth


def _decode(path: Path) -> NDArray[Any]:
    import cv2

    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"the image cannot be opened ({error.strerror}).", path) from error
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError("the image does not decode; it is damaged, cut short or of an unknown format.", path)
    return np.asarray(image)
