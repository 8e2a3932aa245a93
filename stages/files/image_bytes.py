"""Encoding and decoding of image files in memory, and detection of their format and size."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.files.memory_check import check_memory_available

# Bytes per pixel: four 16-bit channels, held once by the decoder and once in the result.
_BYTES_PER_PIXEL = 16
# Maximum pixels of an image; no camera in use exceeds 134 megapixels, so a larger header is damaged or
# hostile.
MAX_PIXELS = 1 << 27
# Maximum texels of a texture atlas: 16384².
_MAX_TEXELS = 1 << 28
PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
# JPEG markers of a frame header, which holds the image size: SOF0-15 without DHT, JPG and DAC.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}

# Magic bytes, extension and media type. TGA has no magic bytes and is recognised by its file name.
_IMAGE_MAGICS = (
    (PNG_MAGIC, ".png", "image/png"),
    (b"\xff\xd8\xff", ".jpg", "image/jpeg"),
    (b"BM", ".bmp", "image/bmp"),
    (b"GIF8", ".gif", "image/gif"),
    (b"II*\0", ".tif", "image/tiff"),
    (b"MM\0*", ".tif", "image/tiff"),
)
_UNKNOWN = ("", "application/octet-stream")


def detect_image_type(data: bytes, name: str = "") -> tuple[str, str]:
    """Detect the extension and media type of an image file.

    Returns ("", "application/octet-stream") for unknown formats.
    """
    for beginning, extension, mime in _IMAGE_MAGICS:
        if data.startswith(beginning):
            return extension, mime
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return ".webp", "image/webp"
    if name.lower().endswith(".tga") and len(data) > 18:
        return ".tga", "image/x-tga"
    return _UNKNOWN


def decode_image(data: bytes) -> NDArray[np.uint8] | None:
    """Decode an image as (h, w, 3) RGB or (h, w, 4) RGBA uint8.

    The top row comes first. 16-bit images are converted to 8 bits. Returns None if the image is damaged or
    too large.
    """
    require_opencv()
    import cv2

    size = read_header_size(data)
    if size is not None and not is_plausible_size(size, _MAX_TEXELS):
        return None
    if data.startswith(PNG_MAGIC) and is_truncated(data):
        return None
    try:
        image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:
        image = None
    if image is None:
        require_image_memory(size)
        return _decode_with_pillow(data)
    if image.dtype == np.uint16:
        image = np.rint(image / 257).astype(np.uint8)
    if image.dtype != np.uint8:
        return None
    if image.ndim == 2:
        code = cv2.COLOR_GRAY2RGB
    else:
        code = cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), np.uint8)


def _decode_with_pillow(data: bytes) -> NDArray[np.uint8] | None:
    """Decode formats that OpenCV does not support, such as TGA.

    Returns None if damaged.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = Image.open(io.BytesIO(data))
            has_alpha = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
            return np.asarray(image.convert("RGBA" if has_alpha else "RGB"), np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """Encode an RGB or RGBA image, (h, w, 3) or (h, w, 4) uint8, as PNG."""
    require_opencv()
    import cv2

    code = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    _, encoded = cv2.imencode(".png", cv2.cvtColor(image, code))
    return encoded.tobytes()


def encode_image(image: NDArray[np.uint8], image_format: str, quality: int) -> bytes:
    """Encode an RGB image as "jpeg", "webp" or "png".

    Parameters
    ----------
    image : (h, w, 3) uint8.
    quality : 1 to 100, for JPEG and WebP; ignored for PNG.
    """
    if image_format == "png":
        return encode_png(image)
    require_opencv()
    import cv2

    options = {
        # No chroma subsampling: it causes red fringes on white.
        "jpeg": [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111],
        "webp": [cv2.IMWRITE_WEBP_QUALITY, quality],
    }
    _, encoded = cv2.imencode(
        {"jpeg": ".jpg", "webp": ".webp"}[image_format], image[:, :, ::-1], options[image_format]
    )
    return encoded.tobytes()


def encode_gray_png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Encode a single-channel image, (h, w) uint8 or uint16, as PNG."""
    import cv2

    _, encoded = cv2.imencode(".png", image)
    return encoded.tobytes()


def is_plausible_size(size: tuple[int, int], max_pixels: int = MAX_PIXELS) -> bool:
    """Return True if a (width, height) is positive and at most `max_pixels` pixels."""
    return size[0] > 0 and size[1] > 0 and size[0] * size[1] <= max_pixels


def require_image_memory(size: tuple[int, int] | None) -> None:
    """Raise MemoryError if decoding an image of this size lacks memory.

    OpenCV reports lack of memory as a failed decode, so callers check after a failure.
    """
    width, height = size or (0, 0)
    check_memory_available(_BYTES_PER_PIXEL * width * height)


def is_truncated(data: bytes) -> bool:
    """Return True if a PNG or JPEG lacks its end marker.

    Some decoders fill the missing part with grey. The chunk lengths of a PNG are followed to its end, because
    OpenCV allocates the length that a chunk claims, up to 4 GB, before reading the chunk.
    """
    if data.startswith(PNG_MAGIC):
        at = len(PNG_MAGIC)
        while at + 12 <= len(data) and data[at + 4 : at + 8] != b"IEND":
            at += 12 + int.from_bytes(data[at : at + 4], "big")
        return at + 12 > len(data)
    return data.startswith(b"\xff\xd8\xff") and data.rfind(b"\xff\xd9") < 0


def read_header_size(data: bytes) -> tuple[int, int] | None:
    """Read the (width, height) that an image header states, unchecked.

    Supports PNG, JPEG, PNM/PFM, TIFF, BMP, GIF and WebP; None for other formats and damaged headers.
    """
    if data.startswith(PNG_MAGIC) and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if data.startswith(b"\xff\xd8"):
        return _read_jpeg_size(data)
    pnm = re.match(rb"P[2356fF]\s+(?:#[^\n]*\n\s*)*(\d{1,10})\s+(?:#[^\n]*\n\s*)*(\d{1,10})\s", data[:4096])
    return (int(pnm[1]), int(pnm[2])) if pnm else _read_size_with_pillow(data)


def _read_jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _JPEG_FRAMES:
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        at += 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def _read_size_with_pillow(data: bytes) -> tuple[int, int] | None:
    """Read the size of a TIFF, BMP, GIF or WebP without decoding the image."""
    kind = detect_image_type(data)[0]
    if kind not in (".tif", ".bmp", ".gif", ".webp"):
        return None
    from PIL import BmpImagePlugin, GifImagePlugin, TiffImagePlugin, WebPImagePlugin

    # Image.open would raise beyond Pillow's own size limit, so the plugin classes are used directly.
    readers: dict[str, Callable[[io.BytesIO], Any]] = {
        ".tif": TiffImagePlugin.TiffImageFile,
        ".bmp": BmpImagePlugin.BmpImageFile,
        ".gif": GifImagePlugin.GifImageFile,
        ".webp": WebPImagePlugin.WebPImageFile,
    }
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            width, height = readers[kind](io.BytesIO(data)).size
    except Exception:  # malformed headers raise many different exceptions in Pillow
        return None
    return width, height
