"""Pairs that were recorded as one image, the left half beside the right one: ZED's and many USB cameras'."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import decode_color, file_bytes, image_size
from scanloom.stages.scans.model.scan import Packed

# Width to height, from two of 5:4 to two of 16:9.
_SHAPES = (2.4, 3.7)
# How alike both halves are where one is moved onto the other, the median: those of real pairs come to
# 0.8 and more (0.6 where a board fills them), those of real photos of streets to 0.56 at most.
_LEAST_ALIKE = 0.62
_LOOKED_AT = 7
# The width at which they are compared, and how far things move from left to right, as a share of it.
_WIDTH, _FARTHEST = 96, 0.25


def are_pairs(paths: Sequence[Path]) -> bool:
    """Say whether images are pairs, by their shape and by how alike their halves are."""
    some = paths[:: max(1, len(paths) // _LOOKED_AT)]
    try:
        shapes = [width / height for width, height in map(image_size, some)]
        if not shapes or not all(_SHAPES[0] <= shape <= _SHAPES[1] for shape in shapes):
            return False
        return float(np.median([_alike(_read(path)) for path in some])) >= _LEAST_ALIKE
    except InputError:
        return False


def halves_of(path: Path) -> tuple[Packed, Packed]:
    """Return the left and the right image of a pair."""
    return Packed(path, "left half", partial(_half, path, 0)), Packed(
        path, "right half", partial(_half, path, 1)
    )


def _read(path: Path) -> NDArray[np.uint8]:
    return decode_color(file_bytes(path), path)


def _half(path: Path, side: int) -> NDArray[np.uint8]:
    image = _read(path)
    width = image.shape[1] // 2
    return np.ascontiguousarray(image[:, side * width : (side + 1) * width])


def _alike(image: NDArray[np.uint8]) -> float:
    """Return the best correlation of the left half's middle with the right half, in its rows."""
    require_opencv()
    import cv2

    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    width = gray.shape[1] // 2
    small = [
        cv2.resize(gray[:, at : at + width], (_WIDTH, _WIDTH * 3 // 4), interpolation=cv2.INTER_AREA)
        for at in (0, width)
    ]
    margin = int(_WIDTH * _FARTHEST)
    # Mounted crooked, cameras see things some rows apart.
    found = cv2.matchTemplate(small[1], small[0][4:-4, margin:-margin], cv2.TM_CCOEFF_NORMED)
    return float(np.nan_to_num(found).max())
