"""Bilinear samples of images at texture coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels

Pixels = NDArray[np.uint8]


def sample_image(
    image: Pixels, uvs: NDArray[np.floating[Any]], wrap: tuple[str, str], channels: int
) -> Pixels:
    """Sample the first channels of an image (h, w, c) at texture coordinates (k, 2), v up.

    Returns
    -------
    (k, channels) uint8.
    """
    return _kernels.sample_points(
        np.ascontiguousarray(image),
        np.ascontiguousarray(uvs, np.float64),
        channels=channels,
        wrap=wrap,
        wanted_threads=0,
    )
