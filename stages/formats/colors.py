"""Colours as files and other libraries store them, and as 8-bit RGB."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def to_uint8(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert colours of any number type to 8 bits.

    Bytes stay as they are, 16-bit values are scaled, and floats are taken as 0..1 unless one of them is
    larger, then as 0..255. The way from bytes to floats (k / 255) and back is exact. Values that are not
    finite become 0.
    """
    values = np.asarray(values)
    if values.dtype == np.uint8:
        return values
    if values.dtype == np.uint16:
        return np.rint(values * (255 / 65535)).astype(np.uint8)
    numbers = np.nan_to_num(values.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    if values.dtype.kind == "f" and numbers.size and numbers.max() <= 1:
        numbers *= 255
    return np.rint(np.clip(numbers, 0, 255)).astype(np.uint8)
