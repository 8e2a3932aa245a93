"""Image files: colour and depth as they are stored, and sizes from headers alone.

Files come from anywhere, so what an image promises is checked before a decoder allocates it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DAMAGED, FILE_DEPTH_FORMAT, FILE_IMAGE_FORMAT, FILE_UNREADABLE
from scanloom.stages.files.exr import exr_size, read_exr
from scanloom.stages.files.image_bytes import (
    MAX_PIXELS,
    PNG_START,
    is_cut_short,
    is_possible,
    promised_size,
    require_room_for,
)
from scanloom.stages.files.numpy_files import NPY_FAULTS, mapped
from scanloom.stages.files.opening import content_of, opened, said_of
from scanloom.stages.files.room import require_room

# Enough of a file to hold its size; a JPEG may carry up to 64 kB blocks (EXIF, colour profile) before it.
_HEADER_BYTES = 1 << 19
# Where a PNG says how its colours are kept, and what it says where they are with transparency.
_PNG_COLOR_TYPE = 25
_PNG_WITH_ALPHA = (b"\x04", b"\x06")


def image_size(path: Path) -> tuple[int, int]:
    """Return (width, height) in pixels, from the header alone where the format is a common one.

    Raises
    ------
    InputError
        If the file is missing or is no image.
    """
    if path.suffix == ".npy":
        height, width = read_raw_depth(path).shape
        return width, height
    if path.suffix.lower() == ".exr":
        return exr_size(path)
    try:
        with opened(path) as file:
            size = promised_size(file.read(_HEADER_BYTES))
    except (OSError, ValueError) as error:
        raise InputError(
            FILE_UNREADABLE, "the image cannot be opened ({said_of}).", path, said_of=said_of(error)
        ) from error
    if size is not None:
        _require_possible(size, path)
        return size
    height, width = read_stored(path).shape[:2]
    return width, height


def read_raw_depth(path: Path) -> NDArray[Any]:
    """Return a depth file's values as they are stored, (h, w) uint16 or float, in the file's own unit.

    Raises
    ------
    InputError
        If the file is missing, does not decode, or is an 8-bit or colour image.
    """
    if path.suffix == ".npy":
        raw = read_array(path, "the depth map")
    elif path.suffix.lower() == ".exr":
        raw = read_exr(path)
    else:
        raw = read_stored(path)
    return require_raw_depth(raw, path)


def read_array(path: Path, what: str) -> NDArray[Any]:
    """Return the array of a .npy file, which stays on disk; raises InputError, which calls it `what`."""
    try:
        array = mapped(path)
    except NPY_FAULTS as error:
        require_room(path.stat().st_size if path.is_file() else 0)
        raise InputError(
            FILE_UNREADABLE, "{what} cannot be read ({error}).", path, what=what, error=error
        ) from error
    return array


def require_raw_depth(raw: NDArray[Any], source: Path | str) -> NDArray[Any]:
    """Return the values of a depth map, or raise InputError where they are none."""
    if raw.ndim != 2:
        raise InputError(
            FILE_DEPTH_FORMAT, "a depth map of one channel is expected; this is a colour image.", source
        )
    if raw.dtype == np.uint8:
        raise InputError(
            FILE_DEPTH_FORMAT, "the depth map has 8 bits a pixel; 16-bit or float depth is expected.", source
        )
    if raw.dtype.kind not in "uif" or raw.size > MAX_PIXELS:
        raise InputError(
            FILE_DEPTH_FORMAT,
            "16-bit or float depth is expected; this is {raw_shape} of type {raw_dtype}.",
            source,
            raw_shape=raw.shape,
            raw_dtype=raw.dtype,
        )
    return raw


def decode_color(data: bytes, source: Path | str) -> NDArray[np.uint8]:
    """Return an encoded image (PNG, JPEG, …) as (h, w, 3) uint8 RGB.

    Raises
    ------
    InputError
        If it does not decode or holds other than 8 bits a channel; `source` is named.
    """
    require_opencv()
    import cv2

    image = _decoded(data, source)
    if image.dtype != np.uint8:
        raise InputError(
            FILE_IMAGE_FORMAT,
            "a colour image of 8 bits a channel is expected; this one is {image_dtype}.",
            source,
            image_dtype=image.dtype,
        )
    if image.ndim == 2:
        return cast("NDArray[np.uint8]", cv2.cvtColor(image, cv2.COLOR_GRAY2RGB))
    code = cv2.COLOR_BGRA2RGB if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return cast("NDArray[np.uint8]", cv2.cvtColor(image, code))


def decode_depth(data: bytes, source: Path | str) -> NDArray[Any]:
    """Return an encoded depth map (PNG, TIFF, …) as stored, (h, w) uint16 or float.

    Raises
    ------
    InputError
        If it does not decode, or is an 8-bit or colour image; `source` is named.
    """
    return require_raw_depth(_decoded(data, source), source)


def has_alpha(path: Path) -> bool:
    """Say whether a file is a PNG with transparency beside its colours."""
    try:
        with opened(path) as file:
            start = file.read(_PNG_COLOR_TYPE + 1)
    except OSError:
        return False  # Reported when the image is read.
    return start.startswith(PNG_START) and start[_PNG_COLOR_TYPE:] in _PNG_WITH_ALPHA


def read_alpha(path: Path) -> NDArray[np.uint8]:
    """Return how opaque each pixel of an image is, (h, w) uint8: 255 where it is so by half or more, else 0.

    Raises
    ------
    InputError
        If the file is missing, does not decode, or has no transparency of 8 bits.
    """
    image = read_stored(path)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 4:
        raise InputError(FILE_IMAGE_FORMAT, "an image with 8 bits of transparency (RGBA) is expected.", path)
    return np.asarray(255 * (image[:, :, 3] >= 128), np.uint8)


def read_stored(path: Path) -> NDArray[Any]:
    """Return an image as it is stored, (h, w) or (h, w, channels), channels in OpenCV's order, blue first.

    Raises
    ------
    InputError
        If the file is missing or does not decode.
    """
    return _decoded(file_bytes(path), path)


def file_bytes(path: Path) -> bytes:
    """Return what is in a file, or raise InputError where it cannot be opened."""
    try:
        return content_of(path)
    except (OSError, ValueError) as error:
        raise InputError(
            FILE_UNREADABLE, "the image cannot be opened ({said_of}).", path, said_of=said_of(error)
        ) from error


def _require_possible(size: tuple[int, int], source: Path | str) -> None:
    if not is_possible(size):
        raise InputError(
            FILE_DAMAGED,
            "the image claims to be {size}×{size_2} pixels; its header is damaged.",
            source,
            size=size[0],
            size_2=size[1],
        )


def _decoded(data: bytes, source: Path | str) -> NDArray[Any]:
    require_opencv()
    import cv2

    if is_cut_short(data):
        raise InputError(
            FILE_DAMAGED, "the image is cut short", source, remedy="copy it again or leave the frame out."
        )
    size = promised_size(data)
    if size is not None:
        _require_possible(size, source)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:
        image = None
    if image is None:
        require_room_for(size)
        raise InputError(
            FILE_DAMAGED, "the image does not decode; it is damaged or of an unknown format.", source
        )
    return np.asarray(image)
