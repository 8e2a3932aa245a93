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


def linear_from_srgb(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how much light displayed values 0..1 stand for (IEC 61966-2-1)."""
    low = np.clip(values, 0, 1)
    return np.where(low <= 0.04045, low / 12.92, ((low + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of `linear_from_srgb`."""
    low = np.clip(values, 0, 1)
    # Written so that 1 stays 1.
    return np.where(low <= 0.0031308, low * 12.92, 1 - 1.055 * (1 - low ** (1 / 2.4)))
