"""Encoding and decoding of image files in memory."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.files.image_headers import PNG_MAGIC, detect_image_format, read_header_size
from scanloom.stages.files.memory_check import check_memory_available

# Bytes per pixel: four 16-bit channels, held once by the decoder and once in the result.
_BYTES_PER_PIXEL = 16
# Maximum pixels of an image; no camera in use exceeds 134 megapixels, so a larger header is damaged or
# hostile.
MAX_PIXELS = 1 << 27
# Maximum texels of a texture atlas: 16384².
_MAX_TEXELS = 1 << 28
# Decoders of Pillow, by extension, for files that OpenCV does not decode.
_PILLOW_FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".bmp": "BMP",
    ".gif": "GIF",
    ".tif": "TIFF",
    ".webp": "WEBP",
    ".tga": "TGA",
}


def decode_image(data: bytes, name: str = "") -> NDArray[np.uint8] | None:
    """Decode an image as (h, w, 3) RGB or (h, w, 4) RGBA uint8.

    The top row comes first. 16-bit images are converted to 8 bits. Returns None if the image is damaged, too
    large, or not one of the formats of `detect_image_format`.

    Parameters
    ----------
    name : file name, by which TGA is recognised.
    """
    kind = detect_image_format(data, name)
    size = read_header_size(data, name)
    if size is None or not is_plausible_size(size, _MAX_TEXELS):
        return None
    if kind == ".png" and is_truncated(data):
        return None
    image = None if kind == ".tga" else decode_with_opencv(data)
    if image is None:
        require_image_memory(size)
        return _decode_with_pillow(data, kind)
    import cv2

    if image.dtype == np.uint16:
        image = np.rint(image / 257).astype(np.uint8)
    if image.dtype != np.uint8:
        return None
    if image.ndim == 2:
        code = cv2.COLOR_GRAY2RGB
    else:
        code = cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), np.uint8)


def decode_with_opencv(data: bytes) -> NDArray[Any] | None:
    """Decode an image whose format and size were checked, as stored; None if it does not decode."""
    require_opencv()
    import cv2

    try:
        image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    # An array of more than four channels, or without pixels, is no image; the decoder of TIFF returns some.
    if image is None or image.size == 0 or (image.ndim == 3 and image.shape[2] not in (3, 4)):
        return None
    return np.asarray(image)


def _decode_with_pillow(data: bytes, kind: str) -> NDArray[np.uint8] | None:
    """Decode with Pillow's decoder of a format, such as TGA, which OpenCV does not support.

    Returns None if damaged.
    """
    if kind not in _PILLOW_FORMATS:
        return None
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = Image.open(io.BytesIO(data), formats=(_PILLOW_FORMATS[kind],))
            if not is_plausible_size(image.size, _MAX_TEXELS):
                return None
            has_alpha = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
            return np.asarray(image.convert("RGBA" if has_alpha else "RGB"), np.uint8)
    except MemoryError:
        raise
    except Exception:  # damaged files raise many different exceptions in Pillow
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
