"""Black borders: what an image that was undistorted, or turned a little, has where nothing was seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.files.images import decode_color, file_bytes

# JPEG lets a little of the neighbours into the black.
_BLACKEST = 8
# Borders reach no farther in than this share of a side; a dark corner of the room may.
_WIDEST = 0.1


def border_mask(path: Path) -> NDArray[np.uint8]:
    """Return (h, w) uint8: 0 where an image is black from its edge on, 255 elsewhere.

    Raises
    ------
    InputError
        If the file is missing or does not decode.
    """
    import cv2

    image = decode_color(file_bytes(path), path)
    black = (image.max(axis=2) <= _BLACKEST).astype(np.uint8)
    height, width = black.shape
    deep, wide = int(_WIDEST * height), int(_WIDEST * width)
    black[deep : height - deep, wide : width - wide] = 0
    # A frame of one pixel around joins all pieces of black that touch the edge.
    framed = cv2.copyMakeBorder(black, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
    _, pieces = cv2.connectedComponents(framed, connectivity=4)
    border = (pieces[1:-1, 1:-1] == pieces[0, 0]).astype(np.uint8)
    # One pixel more, which was interpolated.
    border = cv2.dilate(border, np.ones((3, 3), np.uint8))
    return np.asarray(255 * (border == 0), np.uint8)
