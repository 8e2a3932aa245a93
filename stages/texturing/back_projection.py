"""Detail recovery by back-projection of the residual between photos and texture.

A texel is a mean of photos, and each photo is a mean over its pixels, so pixel-sized details are blurred
twice. The textured mesh is rendered from each camera, and the residual of the photo is added to the photo.
The texture is then painted again from these sharpened photos.

This is iterative back-projection (Irani and Peleg 1991, "Improving resolution by image registration") with a
surface between the images (Goldlücke and Cremers 2009, "Superresolution texture maps for multiview
reconstruction"). It needs photos that are aligned to a fraction of a pixel; otherwise the residual is noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Ratios of a photo's width: margin along the mesh's silhouette where residuals are ignored (`_MARGIN_RATIO`),
# and standard deviation of the smoothing (`_SMOOTHING_RATIO`).
_MARGIN_RATIO, _SMOOTHING_RATIO = 0.01, 0.01
# Smoothed difference between photo and texture, in levels, beyond which the photo shows another surface.
# Details may differ by more, but they cancel in the smoothed image.
_MAX_SMOOTH_DIFFERENCE = 15.0
# Downscaling factor of the images in which differences are smoothed: saves time.
_DOWNSCALING = 4


def add_residual(
    image: NDArray[np.uint8],
    photo: NDArray[np.uint8],
    rendering: NDArray[np.uint8],
    mask: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Add the residual between a photo and a rendering to an image.

    The residual is faded out where photo and texture show different surfaces.

    Parameters
    ----------
    image : (h, w, 3) uint8, the photo, or the photo with the residuals of earlier passes.
    photo : (h, w, 3) uint8.
    rendering : (h, w, 3) uint8, the textured mesh rendered from the photo's camera.
    mask : (h, w) bool, pixels of `rendering` that the mesh covers.

    Returns
    -------
    (h, w, 3) uint8.
    """
    import cv2

    weight = _compute_agreement(photo, rendering, mask)
    # One channel at a time: a large photo in 16 bits would take much memory.
    planes = [
        cv2.add(
            cv2.extractChannel(image, k),
            cv2.multiply(
                _subtract_levels(cv2.extractChannel(photo, k), cv2.extractChannel(rendering, k)),
                weight,
                scale=1 / 255,
                dtype=cv2.CV_16S,
            ),
            dtype=cv2.CV_8U,
        )
        for k in range(3)
    ]
    return np.asarray(cv2.merge(planes), np.uint8)


def _compute_agreement(
    photo: NDArray[np.uint8], rendering: NDArray[np.uint8], mask: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Compute the agreement of a photo and a rendering, (h, w) uint8."""
    import cv2

    height, width = mask.shape
    margin = max(round(_MARGIN_RATIO * width), 1)
    window = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    is_inside = cv2.erode(mask.astype(np.uint8), window, borderType=cv2.BORDER_REPLICATE)
    size = (max(round(width / _DOWNSCALING), 2), max(round(height / _DOWNSCALING), 2))
    max_difference = np.zeros(size[::-1], np.float32)
    for k in range(3):
        difference = _subtract_levels(cv2.extractChannel(photo, k), cv2.extractChannel(rendering, k))
        smaller = cv2.resize(difference, size, interpolation=cv2.INTER_AREA)
        smooth = cv2.GaussianBlur(smaller.astype(np.float32), (0, 0), _SMOOTHING_RATIO * size[0])
        max_difference = np.maximum(max_difference, np.abs(smooth))
    agreement = np.rint(
        255 * np.maximum(1 - (max_difference / np.float32(_MAX_SMOOTH_DIFFERENCE)) ** 2, 0) ** 2
    ).astype(np.uint8)
    return np.asarray(cv2.resize(agreement, (width, height), interpolation=cv2.INTER_LINEAR) * is_inside)


def _subtract_levels(minuend: NDArray[Any], subtrahend: NDArray[Any]) -> NDArray[np.int16]:
    import cv2

    return np.asarray(cv2.subtract(minuend, subtrahend, dtype=cv2.CV_16S), np.int16)
