"""Thumbnail strip of a scan's photos, for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.files.image_bytes import encode_png
from scanloom.stages.files.images import decode_color, read_image_bytes

_HEIGHT_PX = 90
# Maximum aspect ratio (width / height); wider images are squeezed.
_MAX_ASPECT_RATIO = 3.0
_MAX_PHOTOS = 4


def render_thumbnail(photos: Sequence[Any]) -> bytes | None:
    """Render up to four evenly spaced photos as a horizontal strip, encoded as PNG.

    Returns None if there are no photos.

    Parameters
    ----------
    photos : colour images of frames: paths, `PackedImage`, or (h, w, 3) uint8.

    Raises
    ------
    InputError
        If an image cannot be read.
    """
    if not photos:
        return None
    count = min(_MAX_PHOTOS, len(photos))
    chosen = [photos[(2 * k + 1) * len(photos) // (2 * count)] for k in range(count)]
    return encode_png(np.concatenate([_load_thumbnail(photo) for photo in chosen], axis=1))


def _load_thumbnail(photo: Any) -> NDArray[np.uint8]:
    require_opencv()
    import cv2

    if isinstance(photo, Path):
        image = decode_color(read_image_bytes(photo), photo)
    else:
        image = np.asarray(photo.load() if hasattr(photo, "load") else photo)
    if image.ndim == 2:
        image = np.repeat(image[:, :, None], 3, axis=2)
    height, width = image.shape[:2]
    size = (max(round(_HEIGHT_PX * min(width / height, _MAX_ASPECT_RATIO)), 1), _HEIGHT_PX)
    return np.asarray(cv2.resize(image[:, :, :3], size, interpolation=cv2.INTER_AREA), np.uint8)
