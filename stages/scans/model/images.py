"""Reading of frame images: 8-bit RGB colour and float32 depth in metres.

RGB-D images are undistorted here and come out as pinhole images. Stereo pairs stay distorted, because
rectification removes distortion and rotation together. If the camera's rotation during readout is known,
rolling shutter distortion is removed, too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import (
    decode_color,
    read_image_bytes,
    read_raw_depth,
    read_stored_image,
    require_raw_depth,
)
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_MISMATCH,
    CAMERA_PAIR_UNCALIBRATED,
    FRAME_IMAGE_MISSING,
)
from scanloom.stages.scans.model.rolling_shutter import get_color_shutter_turn
from scanloom.stages.scans.model.scan import (
    Camera,
    ColorImage,
    DepthImage,
    Frame,
    PackedImage,
    scale_camera,
    to_pinhole,
)
from scanloom.stages.scans.model.undistortion import SamplingMaps, compute_sampling_maps, resample_to_pinhole

# Metres; smaller depth is invalid, and its inverse would overflow.
_MIN_DEPTH_M = 1e-6
# Relative tolerance of the aspect ratio between image and camera, for rounded image sizes.
_ASPECT_TOLERANCE = 0.02


def read_color(frame: Frame) -> ColorImage | None:
    """Read the colour (or left) image of a frame at its stored size.

    Returns
    -------
    (h, w, 3) uint8 RGB, grey images with three equal channels. None if the frame has no colour image. Images
    of frames with depth are undistorted.

    Raises
    ------
    InputError
        If the file is missing, does not decode, or does not have 8 bits per channel.
    """
    if frame.color is None:
        return None
    image = _read_color_source(frame.color, frame.name)
    camera = frame.color_camera or frame.camera
    if frame.depth is None:
        return image
    return cast(
        ColorImage,
        resample_to_pinhole(image, _compute_maps(image, camera, get_color_shutter_turn(frame)), smooth=True),
    )


def read_pinhole(frame: Frame) -> ColorImage | None:
    """Read the colour image of a single view without lens distortion.

    Returns
    -------
    (h, w, 3) uint8 RGB; None if the frame has no colour image.

    Raises
    ------
    InputError
        As `read_color`, and if the image size differs from the camera's.
    """
    image = read_color(frame)
    if image is None:
        return None
    require_size(image, frame.camera, frame.color, frame.name)
    maps = _compute_maps(image, frame.camera, get_color_shutter_turn(frame))
    return cast(ColorImage, resample_to_pinhole(image, maps, smooth=True))


def read_photo(frame: Frame) -> tuple[ColorImage, Camera, NDArray[np.bool_] | None]:
    """Read the photo of a frame for texturing: undistorted with cubic interpolation.

    Returns
    -------
    image : (h, w, 3) uint8 RGB at its stored size.
    camera : pinhole camera of the image: `get_color_camera`, or `camera` if the frame has no separate one.
    valid : (h, w) bool, False outside the mask and where undistortion samples beyond the image. None if all
        pixels are valid.

    Raises
    ------
    InputError
        If there is no colour image, it cannot be read, its aspect ratio differs from the camera's, or the
        camera is not calibrated.
    """
    if frame.color is None:
        raise InputError(
            FRAME_IMAGE_MISSING, "there is no colour image.", DiagnosticLocation(frame=frame.name)
        )
    image = _read_color_source(frame.color, frame.name)
    height, width = image.shape[:2]
    source_camera = frame.color_camera or frame.camera
    if not source_camera.is_calibrated:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED, "its camera is not calibrated.", _locate_source(frame.color, frame.name)
        )
    if abs(width * source_camera.height / (height * source_camera.width) - 1) > _ASPECT_TOLERANCE:
        require_size(image, source_camera, frame.color, frame.name)
    camera = scale_camera(source_camera, width, height)
    mask = read_mask(frame)
    valid = None if mask is None else _resize_to_camera(mask, camera)
    maps = compute_sampling_maps(camera, width, height, get_color_shutter_turn(frame))
    if maps is not None:
        image = cast(ColorImage, resample_to_pinhole(image, maps, smooth=True, sharp=True))
        whole = np.full((height, width), 255, np.uint8) if valid is None else valid
        valid = cast("NDArray[np.uint8]", resample_to_pinhole(whole, maps, smooth=False))
    return image, to_pinhole(camera), None if valid is None else valid > 0


def read_mask(frame: Frame) -> NDArray[np.uint8] | None:
    """Read the mask of a frame in the size of its camera.

    Returns
    -------
    (h, w) uint8, 0 where the pixel is not part of the scene; None if the frame has no mask. In a colour mask
    only black pixels are 0.

    Raises
    ------
    InputError
        If the file is missing, does not decode, or does not have 8 bits per channel.
    """
    if frame.mask is None:
        return None
    image = _read_source(frame.mask)
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "a mask with 8 bits per channel is expected, not {image_shape} {image_dtype}.",
            _locate_source(frame.mask, frame.name),
            image_shape=image.shape,
            image_dtype=image.dtype,
        )
    return _resize_to_camera(image if image.ndim == 2 else image[:, :, :3].max(axis=2), frame.camera)


def read_valid_pixels(frame: Frame) -> NDArray[np.bool_]:
    """Return the valid pixels of the image that `read_pinhole` returns.

    Returns
    -------
    (h, w) bool, False outside the mask and where undistortion samples beyond the image.

    Raises
    ------
    InputError
        As `read_mask`.
    """
    mask = read_mask(frame)
    valid = np.full((frame.camera.height, frame.camera.width), 255, np.uint8) if mask is None else mask
    return (
        resample_to_pinhole(valid, _compute_maps(valid, frame.camera, frame.shutter_turn), smooth=False) > 0
    )


def read_right(frame: Frame) -> ColorImage | None:
    """Read the right image of a stereo pair.

    Returns
    -------
    (h, w, 3) uint8 RGB with lens distortion; None if the frame has no right image.
    """
    return None if frame.right is None else _read_color_source(frame.right, frame.name)


def read_depth(frame: Frame) -> DepthImage | None:
    """Read the depth map of a frame, without lens distortion.

    Returns
    -------
    (h, w) float32 metres along the optical axis, 0 where missing, masked or below `min_confidence`. The depth
    correction of the frame is applied. None if the frame has no depth.

    Raises
    ------
    InputError
        If the file is missing, does not decode, is an 8-bit or colour image, or its size is not the camera's.
    """
    if frame.depth is None:
        return None
    if isinstance(frame.depth, np.ndarray):
        # Copied, because mask and confidence are applied in place.
        depth = np.array(frame.depth, np.float32)
    else:
        depth = _read_stored_depth(frame.depth, frame)
    require_size(depth, frame.camera, frame.depth, frame.name)
    if frame.confidence is not None:
        depth[_read_confidence(frame.confidence, frame) < frame.min_confidence] = 0
    mask = read_mask(frame)
    if mask is not None:
        depth[mask == 0] = 0
    maps = _compute_maps(depth, frame.camera, frame.shutter_turn)
    depth = cast(DepthImage, resample_to_pinhole(depth, maps, smooth=False))
    depth = np.where(np.isfinite(depth) & (depth > _MIN_DEPTH_M), depth, np.float32(0))
    return depth if frame.depth_correction is None else frame.depth_correction.correct_map(depth)


def require_size(image: NDArray[Any], camera: Camera, source: Path | Any, name: str) -> None:
    """Raise InputError unless the image has the size of the camera's calibration."""
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "the image is {width}×{height} px, but its camera is calibrated for "
                "{camera_width}×{camera_height} px."
            ),
            _locate_source(source, name),
            remedy="Give images of the calibrated size, or a calibration for this size.",
            width=width,
            height=height,
            camera_width=camera.width,
            camera_height=camera.height,
        )


def _compute_maps(
    image: NDArray[Any], camera: Camera, turn: NDArray[np.float64] | None
) -> SamplingMaps | None:
    return compute_sampling_maps(camera, image.shape[1], image.shape[0], turn)


def _read_color_source(source: Path | PackedImage | ColorImage, name: str) -> ColorImage:
    import cv2

    if isinstance(source, PackedImage):
        source, name = source.load(), str(source)
    if isinstance(source, Path):
        return decode_color(read_image_bytes(source), source)
    image = np.asarray(source)
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "colour must be (h, w, 3) uint8, not {image_shape} {image_dtype}.",
            DiagnosticLocation(frame=name),
            image_shape=image.shape,
            image_dtype=image.dtype,
        )
    if image.ndim == 3:
        return np.ascontiguousarray(image[:, :, :3])
    return cast(ColorImage, cv2.cvtColor(image, cv2.COLOR_GRAY2RGB))


def _read_stored_depth(source: Path | PackedImage, frame: Frame) -> DepthImage:
    if isinstance(source, Path):
        raw = read_raw_depth(source)
    else:
        raw = require_raw_depth(source.load(), str(source))
    depth = cast(DepthImage, raw.astype(np.float32) / np.float32(frame.depth_scale))
    for marker in frame.depth_missing:
        depth[raw == marker] = 0
    return depth


def _read_confidence(source: Path | PackedImage | NDArray[np.uint8], frame: Frame) -> NDArray[np.uint8]:
    """Read the confidence map, resized to the depth map without interpolation."""
    image = _read_source(source)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "a single-channel 8-bit confidence map is expected, not {image_shape} {image_dtype}.",
            _locate_source(source, frame.name),
            image_shape=image.shape,
            image_dtype=image.dtype,
        )
    return _resize_to_camera(image, frame.camera)


def _read_source(source: Path | PackedImage | NDArray[np.uint8]) -> NDArray[Any]:
    if isinstance(source, Path):
        return read_stored_image(source)
    return source.load() if isinstance(source, PackedImage) else source


def _resize_to_camera(image: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    import cv2

    size = (camera.width, camera.height)
    # INTER_NEAREST samples at pixel corners; INTER_NEAREST_EXACT samples at pixel centres.
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST_EXACT), np.uint8)


def _locate_source(source: object, name: str) -> Path | str | DiagnosticLocation:
    """Return the location of an image for messages."""
    if isinstance(source, Path):
        return source
    return str(source) if isinstance(source, PackedImage) else DiagnosticLocation(frame=name)
