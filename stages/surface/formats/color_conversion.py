"""Conversion of colours between 8-bit sRGB, other number types and linear light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def to_uint8(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert colours of any number type to 8 bits.

    uint8 is returned unchanged and uint16 is scaled. Floats are 0 to 1 if no value exceeds 1, else 0 to 255.
    The round trip from uint8 to float (k / 255) and back is exact. Values that are not finite become 0.
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


def convert_srgb_to_linear(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert sRGB values 0 to 1 to linear light 0 to 1 (IEC 61966-2-1)."""
    clipped = np.clip(values, 0, 1)
    return np.where(clipped <= 0.04045, clipped / 12.92, ((clipped + 0.055) / 1.055) ** 2.4)


def convert_linear_to_srgb(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert linear light 0 to 1 to sRGB values 0 to 1 (IEC 61966-2-1)."""
    clipped = np.clip(values, 0, 1)
    # This form of the formula maps 1 to exactly 1.
    return np.where(clipped <= 0.0031308, clipped * 12.92, 1 - 1.055 * (1 - clipped ** (1 / 2.4)))
