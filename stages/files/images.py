"""Image files: colour and depth as stored, and image sizes from headers.

Files are untrusted: the size in a header is checked before a decoder allocates memory.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DAMAGED, FILE_DEPTH_FORMAT, FILE_IMAGE_FORMAT, FILE_UNREADABLE
from scanloom.stages.files.exr import read_exr, read_exr_size
from scanloom.stages.files.image_bytes import (
    MAX_PIXELS,
    decode_with_opencv,
    is_plausible_size,
    is_truncated,
    require_image_memory,
)
from scanloom.stages.files.image_headers import (
    PNG_MAGIC,
    detect_image_format,
    name_unsupported_format,
    read_header_size,
)
from scanloom.stages.files.input_files import describe_os_error, open_input, read_input_bytes
from scanloom.stages.files.memory_check import check_memory_available
from scanloom.stages.files.numpy_files import NPY_ERRORS, map_array

# Bytes to read for the image size. JPEG metadata (EXIF, colour profile) in blocks of up to 64 kB may precede
# it.
_HEADER_BYTES = 1 << 19
# Offset of the colour type in a PNG, and its values for grey + alpha and RGB + alpha.
_PNG_COLOR_TYPE_OFFSET = 25
_PNG_ALPHA_TYPES = (b"\x04", b"\x06")
# Bit depth and colour type of RGB, palette, and RGB + alpha, with 8 bits.
_PNG_COLOR_LAYOUTS = (b"\x08\x02", b"\x08\x03", b"\x08\x06")
# Formats of photos with EXIF metadata, as Pillow names them.
_EXIF_FORMATS = ("JPEG", "PNG", "TIFF", "WEBP")


def read_image_size(path: Path) -> tuple[int, int]:
    """Read the (width, height) of an image or depth file, pixels.

    Only the header is read, except for formats without a supported header.

    Raises
    ------
    InputError
        If the file is missing or not an image.
    """
    if path.suffix == ".npy":
        height, width = read_raw_depth(path).shape
        return width, height
    if path.suffix.lower() == ".exr":
        return read_exr_size(path)
    try:
        with open_input(path) as file:
            size = read_header_size(file.read(_HEADER_BYTES))
    except (OSError, ValueError) as error:
        raise InputError(
            FILE_UNREADABLE, "the image cannot be opened ({reason}).", path, reason=describe_os_error(error)
        ) from error
    if size is not None:
        _require_plausible_size(size, path)
        return size
    height, width = read_stored_image(path).shape[:2]
    return width, height


def read_raw_depth(path: Path) -> NDArray[Any]:
    """Read the raw values of a depth file.

    Returns
    -------
    (h, w) unsigned or signed integers of at least 16 bits, or floats, in the unit of the file.

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
        raw = read_stored_image(path)
    return require_raw_depth(raw, path)


def read_array(path: Path, description: str) -> NDArray[Any]:
    """Memory-map the array of a .npy file.

    Parameters
    ----------
    description : name of the file's content in messages, such as "the depth map".

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        array = map_array(path)
    except NPY_ERRORS as error:
        check_memory_available(path.stat().st_size if path.is_file() else 0)
        raise InputError(
            FILE_UNREADABLE, "{what} cannot be read ({error}).", path, what=description, error=error
        ) from error
    return array


def require_raw_depth(raw: NDArray[Any], source: Path | str) -> NDArray[Any]:
    """Check that an array is a raw depth map, (h, w), 16-bit or float.

    Raises
    ------
    InputError
        For colour images, 8-bit images, other dtypes, and images that are too large.
    """
    if raw.ndim != 2:
        raise InputError(
            FILE_DEPTH_FORMAT, "a single-channel depth map is expected; this is a colour image.", source
        )
    if raw.dtype == np.uint8:
        raise InputError(
            FILE_DEPTH_FORMAT,
            "the depth map has 8 bits per pixel; 16-bit or float depth is expected.",
            source,
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
    """Decode an image (PNG, JPEG, …) as (h, w, 3) uint8 RGB.

    Parameters
    ----------
    source : file name for messages.

    Raises
    ------
    InputError
        If the image does not decode, or does not have 8 bits per channel.
    """
    require_opencv()
    import cv2

    image = _decode_stored(data, source)
    if image.dtype != np.uint8:
        raise InputError(
            FILE_IMAGE_FORMAT,
            "a colour image with 8 bits per channel is expected; this one is {image_dtype}.",
            source,
            image_dtype=image.dtype,
        )
    if image.ndim == 2:
        return cast("NDArray[np.uint8]", cv2.cvtColor(image, cv2.COLOR_GRAY2RGB))
    code = cv2.COLOR_BGRA2RGB if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return cast("NDArray[np.uint8]", cv2.cvtColor(image, code))


def decode_depth(data: bytes, source: Path | str) -> NDArray[Any]:
    """Decode a depth map (PNG, TIFF, …) as (h, w) uint16 or float, unscaled.

    Parameters
    ----------
    source : file name for messages.

    Raises
    ------
    InputError
        If the image does not decode, or is an 8-bit or colour image.
    """
    return require_raw_depth(_decode_stored(data, source), source)


def has_alpha(path: Path) -> bool:
    """Return True if a file is a PNG with an alpha channel."""
    try:
        with open_input(path) as file:
            start = file.read(_PNG_COLOR_TYPE_OFFSET + 1)
    except OSError:
        return False  # reported when the image is read
    return start.startswith(PNG_MAGIC) and start[_PNG_COLOR_TYPE_OFFSET:] in _PNG_ALPHA_TYPES


def is_surely_color(path: Path) -> bool:
    """Test if the header of a file is that of a colour image with 8 bits, in JPEG or PNG.

    Other files may be depth or confidence maps.
    """
    try:
        with open_input(path) as file:
            start = file.read(_PNG_COLOR_TYPE_OFFSET + 1)
    except OSError:
        return False
    if not start.startswith(PNG_MAGIC):
        return detect_image_format(start) == ".jpg"
    return start[_PNG_COLOR_TYPE_OFFSET - 1 :] in _PNG_COLOR_LAYOUTS


def read_alpha(path: Path) -> NDArray[np.uint8]:
    """Read the alpha channel of an image as a binary mask.

    Returns
    -------
    (h, w) uint8: 255 where alpha is at least 128, else 0.

    Raises
    ------
    InputError
        If the file is missing, does not decode, or has no 8-bit alpha channel.
    """
    image = read_stored_image(path)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 4:
        raise InputError(FILE_IMAGE_FORMAT, "an image with an 8-bit alpha channel (RGBA) is expected.", path)
    return np.asarray(255 * (image[:, :, 3] >= 128), np.uint8)


def read_stored_image(path: Path) -> NDArray[Any]:
    """Read an image as stored, (h, w) or (h, w, channels).

    Channels are in OpenCV's order (BGR or BGRA), and the dtype is unchanged.

    Raises
    ------
    InputError
        If the file is missing or does not decode.
    """
    return _decode_stored(read_image_bytes(path), path)


def read_exif_number(path: Path, folder: int, tag: int) -> float | None:
    """Read a number of the EXIF metadata of a photo; None if it is missing or damaged.

    Parameters
    ----------
    folder, tag : EXIF tags of the folder, and of the value in it.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings(), open_input(path) as file:
            warnings.simplefilter("ignore")
            image = Image.open(file, formats=_EXIF_FORMATS)
            if image.format == "PNG" and "exif" not in image.info:
                # Pillow would decode the image to look for metadata behind it.
                return None
            return float(image.getexif().get_ifd(folder)[tag])
    except MemoryError:
        raise
    except Exception:  # Damaged metadata raises any exception, and is no reason to reject a photo.
        return None


def read_image_bytes(path: Path) -> bytes:
    """Read the bytes of an image file.

    Raises
    ------
    InputError
        If the file cannot be opened.
    """
    try:
        return read_input_bytes(path)
    except (OSError, ValueError) as error:
        raise InputError(
            FILE_UNREADABLE, "the image cannot be opened ({reason}).", path, reason=describe_os_error(error)
        ) from error


def _require_plausible_size(size: tuple[int, int], source: Path | str) -> None:
    if not is_plausible_size(size):
        raise InputError(
            FILE_DAMAGED,
            "its header is damaged: it states {size}×{size_2} pixels.",
            source,
            size=size[0],
            size_2=size[1],
        )


def _decode_stored(data: bytes, source: Path | str) -> NDArray[Any]:
    if not detect_image_format(data):
        if name := name_unsupported_format(data):
            raise InputError(
                FILE_IMAGE_FORMAT,
                "{format} images are not supported",
                source,
                remedy="convert the image to PNG or JPEG.",
                format=name,
            )
        raise InputError(
            FILE_DAMAGED, "the image does not decode; it is damaged or has an unknown format.", source
        )
    if is_truncated(data):
        raise InputError(
            FILE_DAMAGED, "the image is cut short", source, remedy="copy it again or leave the frame out."
        )
    size = read_header_size(data)
    if size is not None:
        _require_plausible_size(size, source)
    image = None if size is None else decode_with_opencv(data)
    if image is None:
        require_image_memory(size)
        raise InputError(FILE_DAMAGED, "the image does not decode; it is damaged.", source)
    return image
