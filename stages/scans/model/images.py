"""Read a frame's images: 8-bit RGB colour, metric float32 depth.

Lens distortion of RGB-D frames is removed here, so that what comes out is a pinhole image; pairs keep theirs,
because rectification removes it together with the rotation. Where it is known how a camera turns while rows
are read, they come out as if all were read at once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import (
    decode_color,
    file_bytes,
    read_raw_depth,
    read_stored,
    require_raw_depth,
)
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_MISMATCH,
    CAMERA_PAIR_UNCALIBRATED,
    FRAME_IMAGE_MISSING,
)
from scanloom.stages.scans.model.rolling_shutter import turn_of_color
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame, Packed, pinhole, scaled
from scanloom.stages.scans.model.undistortion import Maps, maps_of, undistorted

# Nothing is nearer than this (m); what would be is no measurement, and its inverse no number.
_NEAREST = 1e-6
# By how much an image may be wider or narrower than its camera says, of its height: rounding of its size.
_SAME_SHAPE = 0.02


def read_color(frame: Frame) -> ColorImage | None:
    """Return the frame's colour (or left) image, (h, w, 3) uint8 RGB, at its own size; None if it has none.

    Grey images come back with three equal channels.

    Raises
    ------
    InputError
        If the file is missing, does not decode or holds other than 8 bits a channel.
    """
    if frame.color is None:
        return None
    image = _color(frame.color, frame.name)
    camera = frame.color_camera or frame.camera
    if frame.depth is None:
        return image
    return cast(ColorImage, undistorted(image, _maps(image, camera, turn_of_color(frame)), smooth=True))


def read_pinhole(frame: Frame) -> ColorImage | None:
    """Return the colour image of a single view as `read_color` does, but without lens distortion.

    Raises
    ------
    InputError
        As `read_color`, and if the image is not of the size of the frame's camera.
    """
    image = read_color(frame)
    if image is None:
        return None
    require_size(image, frame.camera, frame.color, frame.name)
    maps = _maps(image, frame.camera, turn_of_color(frame))
    return cast(ColorImage, undistorted(image, maps, smooth=True))


def read_photo(frame: Frame) -> tuple[ColorImage, Camera, NDArray[np.bool_] | None]:
    """Return a frame's colour image without lens distortion, as sharp as it is, and its pinhole camera.

    Returns
    -------
    (h, w, 3) uint8 RGB at its own size; the camera for this size, that of the colour image, or, where the
    frame has none, its own; and which pixels (h, w) show the scene, not those of the mask, nor beyond the
    edge of the image as it was taken. None if all do.

    Raises
    ------
    InputError
        If there is no image, it cannot be read, or it is of another shape than its camera's.
    """
    if frame.color is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no colour image.", Where(frame=frame.name))
    image = _color(frame.color, frame.name)
    height, width = image.shape[:2]
    known = frame.color_camera or frame.camera
    if not known.is_calibrated:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED, "its camera is not calibrated.", _called(frame.color, frame.name)
        )
    if abs(width * known.height / (height * known.width) - 1) > _SAME_SHAPE:
        require_size(image, known, frame.color, frame.name)
    camera = scaled(known, width, height)
    mask = read_mask(frame)
    seen = None if mask is None else _in_size(mask, camera)
    maps = maps_of(camera, width, height, turn_of_color(frame))
    if maps is not None:
        image = cast(ColorImage, undistorted(image, maps, smooth=True, sharp=True))
        whole = np.full((height, width), 255, np.uint8) if seen is None else seen
        seen = cast("NDArray[np.uint8]", undistorted(whole, maps, smooth=False))
    return image, pinhole(camera), None if seen is None else seen > 0


def read_mask(frame: Frame) -> NDArray[np.uint8] | None:
    """Return the frame's mask in the size of its camera, (h, w) uint8, 0 where nothing is; None without one.

    Of a mask in colour, black is what counts.

    Raises
    ------
    InputError
        If the file is missing, does not decode, or has other than 8 bits a channel.
    """
    if frame.mask is None:
        return None
    image = _stored(frame.mask)
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "a mask of 8 bits a channel is expected, not {image_shape} {image_dtype}.",
            _called(frame.mask, frame.name),
            image_shape=image.shape,
            image_dtype=image.dtype,
        )
    return _in_size(image if image.ndim == 2 else image[:, :, :3].max(axis=2), frame.camera)


def read_seen(frame: Frame) -> NDArray[np.bool_]:
    """Return which pixels of what `read_pinhole` returns show the scene, (h, w): not those of the mask.

    Where lens distortion is removed, pixels may lie beyond the edge of the image, too.

    Raises
    ------
    InputError
        As `read_mask`.
    """
    mask = read_mask(frame)
    seen = np.full((frame.camera.height, frame.camera.width), 255, np.uint8) if mask is None else mask
    return undistorted(seen, _maps(seen, frame.camera, frame.shutter_turn), smooth=False) > 0


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
        # A copy: what a mask or too little confidence takes away is taken from it.
        depth = np.array(frame.depth, np.float32)
    else:
        depth = _stored_depth(frame.depth, frame)
    require_size(depth, frame.camera, frame.depth, frame.name)
    if frame.confidence is not None:
        depth[_confidence(frame.confidence, frame) < frame.least_confidence] = 0
    mask = read_mask(frame)
    if mask is not None:
        depth[mask == 0] = 0
    maps = _maps(depth, frame.camera, frame.shutter_turn)
    depth = cast(DepthImage, undistorted(depth, maps, smooth=False))
    return np.where(np.isfinite(depth) & (depth > _NEAREST), depth, np.float32(0))


def require_size(image: NDArray[Any], camera: Camera, source: Path | Any, name: str) -> None:
    """Raise InputError unless the image has the size the camera was calibrated for."""
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "the image is {width}×{height}, but its camera is calibrated for "
                "{camera_width}×{camera_height}."
            ),
            _called(source, name),
            remedy="Give images of the calibrated size, or the calibration of this size.",
            width=width,
            height=height,
            camera_width=camera.width,
            camera_height=camera.height,
        )


def _maps(image: NDArray[Any], camera: Camera, turn: NDArray[np.float64] | None) -> Maps | None:
    return maps_of(camera, image.shape[1], image.shape[0], turn)


def _color(source: Path | Packed | ColorImage, name: str) -> ColorImage:
    import cv2

    if isinstance(source, Packed):
        source, name = source.load(), str(source)
    if isinstance(source, Path):
        return decode_color(file_bytes(source), source)
    image = np.asarray(source)
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "colour must be (h, w, 3) uint8, not {image_shape} {image_dtype}.",
            Where(frame=name),
            image_shape=image.shape,
            image_dtype=image.dtype,
        )
    if image.ndim == 3:
        return np.ascontiguousarray(image[:, :, :3])
    return cast(ColorImage, cv2.cvtColor(image, cv2.COLOR_GRAY2RGB))


def _stored_depth(source: Path | Packed, frame: Frame) -> DepthImage:
    if isinstance(source, Path):
        raw = read_raw_depth(source)
    else:
        raw = require_raw_depth(source.load(), str(source))
    depth = cast(DepthImage, raw.astype(np.float32) / np.float32(frame.depth_scale))
    for marker in frame.depth_missing:
        depth[raw == marker] = 0
    return depth


def _confidence(source: Path | Packed | NDArray[np.uint8], frame: Frame) -> NDArray[np.uint8]:
    """Return the confidence in the size of the depth map, never averaged."""
    image = _stored(source)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "confidence of 8 bits in one channel is expected, not {image_shape} {image_dtype}.",
            _called(source, frame.name),
            image_shape=image.shape,
            image_dtype=image.dtype,
        )
    return _in_size(image, frame.camera)


def _stored(source: Path | Packed | NDArray[np.uint8]) -> NDArray[Any]:
    if isinstance(source, Path):
        return read_stored(source)
    return source.load() if isinstance(source, Packed) else source


def _in_size(image: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    import cv2

    size = (camera.width, camera.height)
    # Plain INTER_NEAREST takes the pixel at the corner, not at the middle.
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST_EXACT), np.uint8)


def _called(source: object, name: str) -> Path | str | Where:
    """Return how a message calls the image of a frame."""
    if isinstance(source, Path):
        return source
    return str(source) if isinstance(source, Packed) else Where(frame=name)
