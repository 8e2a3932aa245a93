"""Image files as bytes: which kind they are, and to and from pixels."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

# No camera in use makes larger images; a header that promises more is damaged or hostile.
MAX_PIXELS = 1 << 27

# Each kind by how its files begin. TGA files have no such mark: their name tells.
_BEGINNINGS = (
    (b"\x89PNG\r\n\x1a\n", ".png", "image/png"),
    (b"\xff\xd8\xff", ".jpg", "image/jpeg"),
    (b"BM", ".bmp", "image/bmp"),
    (b"GIF8", ".gif", "image/gif"),
    (b"II*\0", ".tif", "image/tiff"),
    (b"MM\0*", ".tif", "image/tiff"),
)
_UNKNOWN = ("", "application/octet-stream")


def kind_of(data: bytes, name: str = "") -> tuple[str, str]:
    """Return extension and media type of an image file; empty extension for one that is not known."""
    for beginning, extension, mime in _BEGINNINGS:
        if data.startswith(beginning):
            return extension, mime
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return ".webp", "image/webp"
    if name.lower().endswith(".tga") and len(data) > 18:
        return ".tga", "image/x-tga"
    return _UNKNOWN


def decoded_image(data: bytes) -> NDArray[np.uint8] | None:
    """Return the image as (h, w, 3) RGB or (h, w, 4) RGBA uint8, top row first; None if it is damaged."""
    import cv2

    try:
        image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:
        image = None
    if image is None:
        return _decoded_by_pillow(data)
    if image.dtype == np.uint16:
        image = np.rint(image / 257).astype(np.uint8)
    if image.dtype != np.uint8:
        return None
    if image.ndim == 2:
        code = cv2.COLOR_GRAY2RGB
    else:
        code = cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), np.uint8)


def _decoded_by_pillow(data: bytes) -> NDArray[np.uint8] | None:
    """Decode what OpenCV does not know, such as TGA."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = Image.open(io.BytesIO(data))
            has_alpha = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
            return np.asarray(image.convert("RGBA" if has_alpha else "RGB"), np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def encoded_png(image: NDArray[np.uint8]) -> bytes:
    """Return an RGB or RGBA image as a PNG file."""
    import cv2

    code = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    _, encoded = cv2.imencode(".png", cv2.cvtColor(image, code))
    return encoded.tobytes()
