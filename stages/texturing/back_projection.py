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

# Ratios of a photo's width: margin along the mesh's silhouette where residuals are ignored (`_MARGIN`), and
# standard deviation of the smoothing (`_SMOOTH`).
_MARGIN, _SMOOTH = 0.01, 0.01
# Smoothed difference between photo and texture, in levels, beyond which the photo shows another surface.
# Details may differ by more, but they cancel in the smoothed image.
_ELSE = 15.0
# Downscaling factor of the images in which differences are smoothed: saves time.
_SHARE = 4


def with_lacking(
    image: NDArray[np.uint8],
    photo: NDArray[np.uint8],
    drawn: NDArray[np.uint8],
    shown: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Add the residual between a photo and a rendering to an image.

    The residual is faded out where photo and texture show different surfaces.

    Parameters
    ----------
    image : (h, w, 3) uint8, the photo, or the photo with the residuals of earlier passes.
    photo : (h, w, 3) uint8.
    drawn : (h, w, 3) uint8, the textured mesh rendered from the photo's camera.
    shown : (h, w) bool, pixels of `drawn` that the mesh covers.

    Returns
    -------
    (h, w, 3) uint8.
    """
    import cv2

    weight = _agreeing(photo, drawn, shown)
    # One channel at a time: a large photo in 16 bits would take much memory.
    planes = [
        cv2.add(
            cv2.extractChannel(image, k),
            cv2.multiply(
                _difference(cv2.extractChannel(photo, k), cv2.extractChannel(drawn, k)),
                weight,
                scale=1 / 255,
                dtype=cv2.CV_16S,
            ),
            dtype=cv2.CV_8U,
        )
        for k in range(3)
    ]
    return np.asarray(cv2.merge(planes), np.uint8)


def _agreeing(
    photo: NDArray[np.uint8], drawn: NDArray[np.uint8], shown: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Compute the agreement of a photo and a rendering, (h, w) uint8."""
    import cv2

    height, width = shown.shape
    reach = max(round(_MARGIN * width), 1)
    window = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    inside = cv2.erode(shown.astype(np.uint8), window, borderType=cv2.BORDER_REPLICATE)
    size = (max(round(width / _SHARE), 2), max(round(height / _SHARE), 2))
    apart = np.zeros(size[::-1], np.float32)
    for k in range(3):
        difference = _difference(cv2.extractChannel(photo, k), cv2.extractChannel(drawn, k))
        smaller = cv2.resize(difference, size, interpolation=cv2.INTER_AREA)
        smooth = cv2.GaussianBlur(smaller.astype(np.float32), (0, 0), _SMOOTH * size[0])
        apart = np.maximum(apart, np.abs(smooth))
    agreeing = np.rint(255 * np.maximum(1 - (apart / np.float32(_ELSE)) ** 2, 0) ** 2).astype(np.uint8)
    return np.asarray(cv2.resize(agreeing, (width, height), interpolation=cv2.INTER_LINEAR) * inside)


def _difference(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.int16]:
    import cv2

    return np.asarray(cv2.subtract(one, other, dtype=cv2.CV_16S), np.int16)
