"""How far a disparity can be trusted, from what the matcher's own result says about it.

Three signs, each in pixels, add up to a spread: the left–right residual; how far the disparity departs
from a plane around the pixel; and the share of neighbours without a match. On the Middlebury pairs with
ground truth most wrong matches that survive the left–right check are the fringe of the background (and of
what the right camera cannot see) that takes on a foreground's disparity; they lie within two pixels of a
jump, and the second sign finds them. A plane has none of it however obliquely it is seen, so that roads
and floors stay.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.stereo.matching import SUBPIXELS, Disparity16, Mask, SearchRange

# Second differences reach this far each way: a block of 3 or 5 pixels blurs a jump by that much.
_REACH = 2
# A missing neighbour stands for the farthest disparity matched this near to it: behind the gap beside
# a foreground lies the background.
_FILL = 9
# Spread, in pixels, of a pixel none of whose neighbours this far each way has a match.
_ALONE = 4
_NEIGHBOURS = 4
# The spread at which confidence is one half. Chosen on Middlebury's Motorcycle (2014), looked at on Cones
# (2003), and checked on the street of KITTI by how well consecutive frames' depth agrees.
_HALF = 1.5
# Departures beyond this change nothing: confidence is a hundredth by then.
_LARGEST = 16 * SUBPIXELS


def confidence(
    disparity: Disparity16, residual: NDArray[np.int16], matched: Mask, search: SearchRange
) -> NDArray[np.uint8]:
    """Confidence of each left pixel, 255 / (1 + (spread / 1.5 px)²); 0 where not matched.

    Parameters
    ----------
    disparity : (h, w) int16, 1/16 px.
    residual : (h, w) int16, 1/16 px, left against right (see `scanloom.stages.stereo.matching`).
    matched : (h, w), the pixels that hold a measurement.
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
    """Return the largest second difference over the four directions through each pixel, clipped."""
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
        # Clipped first: the negative of the smallest int16 is none.
        np.maximum(result, np.abs(np.clip(bend, -_LARGEST, _LARGEST)), out=result)
    return result


def _table() -> NDArray[np.uint8]:
    spread = np.arange(_LARGEST + 2 * SUBPIXELS * _ALONE + 1) / SUBPIXELS
    return np.asarray(np.round(255 / (1 + (spread / _HALF) ** 2)), np.uint8)
