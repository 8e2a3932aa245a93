"""Read a frame's images: 8-bit RGB colour, metric float32 depth.

Lens distortion of RGB-D frames is removed here, so that what comes out is a pinhole image; pairs keep theirs,
because rectification removes it together with the rotation.

Files come from anywhere, so what an image promises is checked before a decoder allocates it.
"""

from __future__ import annotations

import functools
import re
import tokenize
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.files.exr import exr_size, read_exr
from stages.files.image_bytes import MAX_PIXELS
from stages.scans.scan import Camera, ColorImage, DepthImage, Frame, Packed, scaled

# Enough of a file to hold its size; a JPEG may carry up to 64 kB blocks (EXIF, colour profile) before it.
_HEADER_BYTES = 1 << 19
# What numpy raises for damaged headers, which it parses as Python.
_NPY_FAULTS = (
    OSError,
    ValueError,
    EOFError,
    TypeError,
    OverflowError,
    MemoryError,
    RecursionError,
    SyntaxError,
    tokenize.TokenError,
)
_PNG_START = b"\x89PNG\r\n\x1a\n"
# Where a PNG says how its colours are kept, and what it says where they are with transparency.
_PNG_COLOR_TYPE = 25
_PNG_WITH_ALPHA = (b"\x04", b"\x06")
# JPEG markers that start a frame (and so hold its size): SOF0-15 without DHT, JPG and DAC.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


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
    if frame.depth is None or not camera.distortion:
        return image
    return cast(ColorImage, _undistorted(image, camera, smooth=True))


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
    if not frame.camera.distortion:
        return image
    return cast(ColorImage, _undistorted(image, frame.camera, smooth=True))


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
            f"a mask of 8 bits a channel is expected, not {image.shape} {image.dtype}.",
            _called(frame.mask, frame.name),
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
    if frame.camera.distortion:
        seen = cast("NDArray[np.uint8]", _undistorted(seen, frame.camera, smooth=False))
    return np.asarray(seen > 0)


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
        depth = _stored_depth(frame.depth, frame)
    require_size(depth, frame.camera, frame.depth, frame.name)
    if frame.confidence is not None:
        depth[_confidence(frame.confidence, frame) < frame.least_confidence] = 0
    mask = read_mask(frame)
    if mask is not None:
        depth[mask == 0] = 0
    if frame.camera.distortion:
        depth = cast(DepthImage, _undistorted(depth, frame.camera, smooth=False))
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))


def read_raw_depth(path: Path) -> NDArray[Any]:
    """Return a depth file's values as they are stored, (h, w) uint16 or float, in the file's own unit.

    Raises
    ------
    InputError
        If the file is missing, does not decode, or is an 8-bit or colour image.
    """
    if path.suffix == ".npy":
        try:
            # Mapped, not read: a header that promises more than the file holds then fails at once.
            raw: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
        except _NPY_FAULTS as error:
            raise InputError(f"the depth map cannot be read ({error}).", path) from error
    elif path.suffix.lower() == ".exr":
        raw = read_exr(path)
    else:
        raw = read_stored(path)
    return require_raw_depth(raw, path)


def require_raw_depth(raw: NDArray[Any], source: Path | str) -> NDArray[Any]:
    """Return the values of a depth map, or raise InputError where they are none."""
    if raw.ndim != 2:
        raise InputError("a depth map of one channel is expected; this is a colour image.", source)
    if raw.dtype == np.uint8:
        raise InputError("the depth map has 8 bits a pixel; 16-bit or float depth is expected.", source)
    if raw.dtype.kind not in "uif" or raw.size > MAX_PIXELS:
        raise InputError(
            f"16-bit or float depth is expected; this is {raw.shape} of type {raw.dtype}.", source
        )
    return raw


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
        with path.open("rb") as file:
            size = _promised_size(file.read(_HEADER_BYTES))
    except (OSError, ValueError) as error:
        raise InputError(f"the image cannot be opened ({error}).", path) from error
    if size is not None:
        return size
    height, width = read_stored(path).shape[:2]
    return width, height


def decode_color(data: bytes, source: Path | str) -> ColorImage:
    """Return an encoded image (PNG, JPEG, …) as (h, w, 3) uint8 RGB.

    Raises
    ------
    InputError
        If it does not decode or holds other than 8 bits a channel; `source` is named.
    """
    import cv2

    image = _decoded(data, source)
    if image.dtype != np.uint8:
        raise InputError(
            f"a colour image of 8 bits a channel is expected; this one is {image.dtype}.", source
        )
    if image.ndim == 2:
        return cast(ColorImage, cv2.cvtColor(image, cv2.COLOR_GRAY2RGB))
    code = cv2.COLOR_BGRA2RGB if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return cast(ColorImage, cv2.cvtColor(image, code))


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
        with path.open("rb") as file:
            start = file.read(_PNG_COLOR_TYPE + 1)
    except OSError:
        return False  # Reported when the image is read.
    return start.startswith(_PNG_START) and start[_PNG_COLOR_TYPE:] in _PNG_WITH_ALPHA


def read_alpha(path: Path) -> NDArray[np.uint8]:
    """Return how opaque each pixel of an image is, (h, w) uint8: 255 where it is so by half or more, else 0.

    Raises
    ------
    InputError
        If the file is missing, does not decode, or has no transparency of 8 bits.
    """
    image = read_stored(path)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 4:
        raise InputError("an image with 8 bits of transparency (RGBA) is expected.", path)
    return np.asarray(255 * (image[:, :, 3] >= 128), np.uint8)


def require_size(image: NDArray[Any], camera: Camera, source: Path | Any, name: str) -> None:
    """Raise InputError unless the image has the size the camera was calibrated for."""
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"the image is {width}×{height}, but its camera is calibrated for "
            f"{camera.width}×{camera.height}. "
            "Give images of the calibrated size, or the calibration of this size.",
            _called(source, name),
        )


def _undistorted(image: NDArray[Any], camera: Camera, *, smooth: bool) -> NDArray[Any]:
    """Return what a pinhole camera with the same matrix sees; depth is never averaged across an edge."""
    import cv2

    across, down = _undistortion(camera, image.shape[1], image.shape[0])
    return cv2.remap(image, across, down, cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST)


@functools.lru_cache(maxsize=4)
def _undistortion(camera: Camera, width: int, height: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the maps for images of a size, the camera's matrix scaled to it."""
    import cv2

    matrix = scaled(camera, width, height).matrix
    distortion = np.array(camera.distortion)
    if camera.fisheye:
        return cv2.fisheye.initUndistortRectifyMap(
            matrix, distortion, np.eye(3), matrix, (width, height), cv2.CV_32FC1
        )
    return cv2.initUndistortRectifyMap(matrix, distortion, np.eye(3), matrix, (width, height), cv2.CV_32FC1)


def _color(source: Path | Packed | ColorImage, name: str) -> ColorImage:
    import cv2

    if isinstance(source, Packed):
        source, name = source.load(), str(source)
    if isinstance(source, Path):
        return decode_color(file_bytes(source), source)
    image = np.asarray(source)
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise InputError(f"colour must be (h, w, 3) uint8, not {image.shape} {image.dtype}.", f"frame {name}")
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
            f"confidence of 8 bits in one channel is expected, not {image.shape} {image.dtype}.",
            _called(source, frame.name),
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


def _called(source: object, name: str) -> Path | str:
    """Return how a message calls the image of a frame."""
    if isinstance(source, Path):
        return source
    return str(source) if isinstance(source, Packed) else f"frame {name}"


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
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(f"the image cannot be opened ({error}).", path) from error


def _decoded(data: bytes, source: Path | str) -> NDArray[Any]:
    import cv2

    if _is_cut_short(data):
        raise InputError("the image is cut short; copy it again or leave the frame out.", source)
    size = _promised_size(data)
    if size is not None and not 0 < size[0] * size[1] <= MAX_PIXELS:
        raise InputError(f"the image claims to be {size[0]}×{size[1]} pixels; its header is damaged.", source)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError("the image does not decode; it is damaged or of an unknown format.", source)
    return np.asarray(image)


def _is_cut_short(data: bytes) -> bool:
    """Say whether a PNG or JPEG lacks its end; some decoders would fill the rest with grey.

    The parts of a PNG are walked: OpenCV reserves whatever one claims to hold, up to 4 GB, before it is read.
    """
    if data.startswith(_PNG_START):
        at = len(_PNG_START)
        while at + 12 <= len(data) and data[at + 4 : at + 8] != b"IEND":
            at += 12 + int.from_bytes(data[at : at + 4], "big")
        return at + 12 > len(data)
    return data.startswith(b"\xff\xd8\xff") and data.rfind(b"\xff\xd9") < 0


def _promised_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) as a PNG, JPEG or PNM header states them; None for other formats."""
    if data.startswith(_PNG_START) and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if data.startswith(b"\xff\xd8"):
        return _jpeg_size(data)
    pnm = re.match(rb"P[2356fF]\s+(?:#[^\n]*\n\s*)*(\d{1,10})\s+(?:#[^\n]*\n\s*)*(\d{1,10})\s", data[:4096])
    return (int(pnm[1]), int(pnm[2])) if pnm else None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _JPEG_FRAMES:
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        at += 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None
