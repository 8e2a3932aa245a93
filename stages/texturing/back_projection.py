"""What photos show that the texture lacks: details that a mean of many photos loses.

A texel is a mean of photos, each of which is a mean over its pixels: what is as small as a pixel gets blurred
twice. The mesh with the texture is drawn from each camera, what the photo shows beyond that is added to the
photo, and the texture is painted again from these: the iterative back-projection of Irani and Peleg 1991,
"Improving resolution by image registration", here with a surface between the images as of Goldlücke and
Cremers 2009, "Superresolution texture maps for multiview reconstruction". It helps where photos are where
they should be to a fraction of a pixel. Where they are not, what they show beyond it says nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Of a photo's width: how near to where the mesh ends nothing is believed, and the spread of what is smoothed.
_MARGIN, _SMOOTH = 0.01, 0.01
# Levels that photo and texture differ by when smoothed, beyond which the photo shows something else. Details
# differ by more, but to both sides.
_ELSE = 15.0
# Smoothed differences are worked out in images that are smaller by this.
_SHARE = 4


def with_lacking(
    image: NDArray[np.uint8],
    photo: NDArray[np.uint8],
    drawn: NDArray[np.uint8],
    shown: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return an image with the levels that a texture lacks of a photo, where both show the same.

    Parameters
    ----------
    image : (h, w, 3) uint8, the photo, or the photo with what other textures lack.
    photo : (h, w, 3) uint8.
    drawn : (h, w, 3) uint8, the textured mesh from the photo's camera.
    shown : (h, w), where it shows the mesh.
    """
    import cv2

    weight = _agreeing(photo, drawn, shown)
    # A channel at a time, for large photos.
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
    """Return how far a photo shows what the texture shows, (h, w) 0 to 255."""
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
