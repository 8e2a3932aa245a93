"""Confidence of a disparity map from the matcher's own result.

Three indicators, in pixels, add up to a spread: the left–right residual; the deviation of the disparity from
a local plane; and the ratio of neighbours without a match.

On the Middlebury pairs with ground truth, most wrong matches that pass the left–right check are background or
occluded pixels next to a foreground object. They have the disparity of the foreground, and are within two
pixels of a disparity jump. The second indicator detects them. It is zero on a plane at any angle, so that
roads and floors keep their confidence.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.stereo.matching import SUBPIXELS, Disparity16, Mask, SearchRange

# Reach of the second differences, pixels: a matching block of 3 or 5 pixels blurs a jump by this much.
_REACH = 2
# Window in which a missing pixel takes the farthest disparity: a gap next to a foreground object is
# background.
_FILL = 9
# Spread, in pixels, of a pixel without matched neighbours, and the reach of the neighbourhood in pixels.
_ALONE = 4
_NEIGHBOURS = 4
# Spread at which the confidence is one half, pixels. Chosen on Middlebury Motorcycle (2014) and checked on
# Cones (2003), and on KITTI by the agreement of depth between consecutive frames.
_HALF = 1.5
# Clipping limit: the confidence is 1 % there already.
_LARGEST = 16 * SUBPIXELS


def confidence(
    disparity: Disparity16, residual: NDArray[np.int16], matched: Mask, search: SearchRange
) -> NDArray[np.uint8]:
    """Compute the confidence of each left pixel.

    The confidence is 255 / (1 + (spread / 1.5 px)²), and 0 where not matched.

    Parameters
    ----------
    disparity : (h, w) int16, 1/16 px.
    residual : (h, w) int16, 1/16 px, left–right residual (see `scanloom.stages.stereo.matching`).
    matched : (h, w), pixels with a measurement.

    Returns
    -------
    (h, w) uint8.
    """
    import cv2

    window = (2 * _NEIGHBOURS + 1, 2 * _NEIGHBOURS + 1)
    alone = cv2.boxFilter(
        (~matched).astype(np.uint8), -1, window, normalize=False, borderType=cv2.BORDER_REPLICATE
    )
    spread = np.minimum(residual, np.int16(SUBPIXELS * _ALONE))
    spread += _departure(disparity, matched, search)
    spread += alone.astype(np.int16) * np.int16(SUBPIXELS * _ALONE) // np.int16(window[0] * window[1])
    return np.asarray(np.where(matched, _table().take(spread, mode="clip"), 0), np.uint8)


def _departure(disparity: Disparity16, matched: Mask, search: SearchRange) -> NDArray[np.int16]:
    """Return the maximum second difference of four directions, clipped."""
    import cv2

    beyond = np.int16(SUBPIXELS * search.end)
    filled = np.where(matched, disparity, beyond)
    farthest = cv2.erode(filled, np.ones((_FILL, _FILL), np.uint8))
    filled = np.where(matched, disparity, farthest)
    size = 2 * _REACH + 1
    result = np.zeros_like(disparity)
    for row, column in ((_REACH, 0), (0, _REACH), (0, 0), (0, 2 * _REACH)):
        kernel = np.zeros((size, size), np.float32)
        kernel[row, column] = kernel[size - 1 - row, size - 1 - column] = -1
        kernel[_REACH, _REACH] = 2
        bend = cv2.filter2D(filled, cv2.CV_16S, kernel, borderType=cv2.BORDER_REPLICATE)
        # Clipped first, because the absolute value of the minimum int16 overflows.
        np.maximum(result, np.abs(np.clip(bend, -_LARGEST, _LARGEST)), out=result)
    return result


def _table() -> NDArray[np.uint8]:
    spread = np.arange(_LARGEST + 2 * SUBPIXELS * _ALONE + 1) / SUBPIXELS
    return np.asarray(np.round(255 / (1 + (spread / _HALF) ** 2)), np.uint8)
