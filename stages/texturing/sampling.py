"""Bilinear samples of images at many texture coordinates, by OpenCV."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages._opencv import require_opencv

Pixels = NDArray[np.uint8]

# Samples are laid out in rows of this many, as OpenCV takes them; it counts rows in 16 bits.
_ROW = 1024
_MAX_ROWS = 1 << 14
# Texels that an image is continued by, beyond each edge.
_MARGIN = 2


def sample_image(image: Pixels, uvs: NDArray[np.floating[Any]], wrap: tuple[str, str]) -> Pixels:
    """Sample an image (h, w, c) bilinearly at texture coordinates (k, 2), v up.

    Returns
    -------
    (k, c) uint8. Coordinates are resolved to 1/32 texel.
    """
    require_opencv()
    import cv2

    height, width, channels = image.shape
    modes = {"repeat": cv2.BORDER_WRAP, "clamp": cv2.BORDER_REPLICATE, "mirror": cv2.BORDER_REFLECT}
    margins = ((0, 0, _MARGIN, _MARGIN), (_MARGIN, _MARGIN, 0, 0))
    padded: Any = image
    for way, (top, bottom, left, right) in zip(wrap, margins, strict=True):
        padded = cv2.copyMakeBorder(padded, top, bottom, left, right, modes[way])
    columns = _to_pixels(uvs[:, 0], width, wrap[0])
    rows = _to_pixels(1 - uvs[:, 1], height, wrap[1])
    found = np.empty((len(uvs), channels), np.uint8)
    step = _ROW * _MAX_ROWS
    for start in range(0, len(uvs), step):
        part = slice(start, start + step)
        x, y = _reshape_to_rows(columns[part]), _reshape_to_rows(rows[part])
        sampled = cv2.remap(padded, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        found[part] = np.asarray(sampled).reshape(-1, channels)[: len(found[part])]
    return found


def _to_pixels(at: NDArray[np.floating[Any]], count: int, way: str) -> NDArray[np.float32]:
    """Convert texture coordinates to texels of the padded image."""
    if way == "clamp":
        at = at.clip(0, 1)
    elif way == "repeat":
        if len(at) and not (at.min() >= 0 and at.max() <= 1):
            at = at - np.floor(at)
    else:
        at = 1 - np.abs(1 - (at - 2 * np.floor(at / 2)))
    found: NDArray[np.float32] = np.multiply(at, count, dtype=np.float32, casting="same_kind")
    found += np.float32(_MARGIN - 0.5)
    return found


def _reshape_to_rows(values: NDArray[np.float32]) -> NDArray[np.float32]:
    rows = -(-len(values) // _ROW)
    if rows * _ROW == len(values):
        return values.reshape(rows, _ROW)
    found = np.zeros(rows * _ROW, np.float32)
    found[: len(values)] = values
    return found.reshape(rows, _ROW)
