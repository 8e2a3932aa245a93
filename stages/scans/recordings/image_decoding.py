"""Decoding of ROS images into RGB colour or raw depth maps."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.files.image_bytes import MAX_PIXELS
from scanloom.stages.files.images import decode_color, decode_depth
from scanloom.stages.scans.codes import RECORDING_ENCODING_UNKNOWN
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.scans.recordings.messages import ImageMessage, read_compressed, read_image

# Type name suffix: `sensor_msgs/CompressedImage` in ROS 1, `sensor_msgs/msg/CompressedImage` in ROS 2.
_COMPRESSED_TYPE_SUFFIX = "CompressedImage"
_QUANTIZATION = struct.Struct("<iff")
_PNG = b"\x89PNG\r\n\x1a\n"
_DEPTH_DTYPES = {"mono16": "u2", "16uc1": "u2", "z16": "u2", "32fc1": "f4"}
# Bytes per pixel, and the OpenCV conversion to RGB (None if already RGB).
_COLOR_CONVERSIONS: dict[str, tuple[int, str | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, "COLOR_BGR2RGB"),
    "8uc3": (3, "COLOR_BGR2RGB"),
    "rgba8": (4, "COLOR_RGBA2RGB"),
    "bgra8": (4, "COLOR_BGRA2RGB"),
    "8uc4": (4, "COLOR_BGRA2RGB"),
    "mono8": (1, "COLOR_GRAY2RGB"),
    "8uc1": (1, "COLOR_GRAY2RGB"),
    "y8": (1, "COLOR_GRAY2RGB"),
    # ROS's yuv422 is UYVY. The YUYV order is yuv422_yuy2 in ROS, and yuyv or yuy2 in RealSense files.
    "yuv422": (2, "COLOR_YUV2RGB_UYVY"),
    "uyvy": (2, "COLOR_YUV2RGB_UYVY"),
    "yuv422_yuy2": (2, "COLOR_YUV2RGB_YUYV"),
    "yuyv": (2, "COLOR_YUV2RGB_YUYV"),
    "yuy2": (2, "COLOR_YUV2RGB_YUYV"),
}


def is_depth(encoding: str) -> bool:
    """Return True if images of this encoding can be depth maps."""
    return encoding.lower() in _DEPTH_DTYPES


def is_color(encoding: str) -> bool:
    """Return True if images of this encoding are colour or greyscale."""
    return encoding.lower() in _COLOR_CONVERSIONS


def decode_color_message(data: bytes, kind: str, source: Path | str, *, is_cdr: bool = False) -> ColorImage:
    """Decode an image message to (h, w, 3) uint8 RGB.

    Parameters
    ----------
    kind : message type; distinguishes compressed from raw images.
    source : location in error messages.
    is_cdr : True for ROS 2.

    Raises
    ------
    InputError
        If the message is damaged, the encoding is unknown, or the data does not have the stated size.
    """
    if kind.endswith(_COMPRESSED_TYPE_SUFFIX):
        return decode_color(read_compressed(data, source, is_cdr=is_cdr)[1], source)
    return _decode_color_image(read_image(data, source, is_cdr=is_cdr), source)


def decode_depth_message(data: bytes, kind: str, source: Path | str, *, is_cdr: bool = False) -> NDArray[Any]:
    """Decode a depth message to (h, w) uint16 or float32, as stored.

    Parameters and errors as for `decode_color_message`.
    """
    if kind.endswith(_COMPRESSED_TYPE_SUFFIX):
        return _decode_compressed_depth(*read_compressed(data, source, is_cdr=is_cdr), source)
    return _decode_depth_image(read_image(data, source, is_cdr=is_cdr), source)


def _decode_color_image(image: ImageMessage, source: Path | str) -> ColorImage:
    import cv2

    known = _COLOR_CONVERSIONS.get(image.encoding.lower())
    if known is None:
        raise InputError(
            RECORDING_ENCODING_UNKNOWN,
            "unknown colour encoding {encoding!r}",
            source,
            remedy="record colour as rgb8.",
            encoding=image.encoding[:20],
        )
    size, conversion = known
    pixels = _extract_rows(image, size, source).reshape(image.height, image.width, size)
    if conversion is None:
        return pixels
    if size == 2 and image.width % 2:
        raise InputError(
            RECORDING_DAMAGED,
            "the width of a {encoding} image must be even, but it is {image_width} pixels.",
            source,
            encoding=image.encoding,
            image_width=image.width,
        )
    return cast(ColorImage, cv2.cvtColor(pixels, getattr(cv2, conversion)))


def _decode_depth_image(image: ImageMessage, source: Path | str) -> NDArray[Any]:
    kind = _DEPTH_DTYPES.get(image.encoding.lower())
    if kind is None:
        raise InputError(
            RECORDING_ENCODING_UNKNOWN,
            "unknown depth encoding {encoding!r}; 16-bit (16UC1, mono16) or float (32FC1) is expected.",
            source,
            encoding=image.encoding[:20],
        )
    stored = np.dtype(kind).newbyteorder(">" if image.is_big_endian else "<")
    rows = _extract_rows(image, stored.itemsize, source)
    return cast("NDArray[Any]", rows.view(stored).astype(kind))


def _decode_compressed_depth(form: str, data: bytes, source: Path | str) -> NDArray[Any]:
    # `compressedDepth` puts a format code and two quantisation parameters before the PNG; the parameters
    # matter only for float depth.
    start = data.find(_PNG, 0, 64)
    if start < 0:
        raise InputError(
            RECORDING_ENCODING_UNKNOWN,
            "unknown depth compression {form!r}; only `compressedDepth png` is supported.",
            source,
            remedy="Record depth uncompressed.",
            form=form[:40],
        )
    stored = decode_depth(data[start:], source)
    if "32fc1" not in form.lower():
        return stored
    if start != _QUANTIZATION.size or stored.dtype != np.uint16:
        raise InputError(
            RECORDING_DAMAGED,
            "the quantisation parameters before the compressed depth are missing or damaged.",
            source,
        )
    _, factor, offset = _QUANTIZATION.unpack_from(data)
    # The encoder stores factor / depth + offset, and 0 for missing depth.
    with np.errstate(all="ignore"):
        inverse = stored.astype(np.float32) - np.float32(offset)
        depth: NDArray[np.float32] = np.float32(factor) / np.where(inverse > 0, inverse, np.float32(1))
    depth[(stored == 0) | ~(inverse > 0)] = 0
    return depth


def _extract_rows(image: ImageMessage, size: int, source: Path | str) -> NDArray[np.uint8]:
    """Return the pixel bytes (h, w · size) uint8 without row padding."""
    width, height, used = image.width, image.height, image.width * size
    if not 0 < width * height <= MAX_PIXELS:
        raise InputError(
            RECORDING_DAMAGED,
            "the stated image size {width}×{height} pixels is invalid; the message is damaged.",
            source,
            width=width,
            height=height,
        )
    if image.step < used or len(image.data) < image.step * height:
        raise InputError(
            RECORDING_DAMAGED,
            "the message is too short for the stated {width}×{height} pixels of {size} bytes.",
            source,
            width=width,
            height=height,
            size=size,
        )
    rows = image.data[: image.step * height].reshape(height, image.step)
    return np.ascontiguousarray(rows[:, :used])
