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

from scanloom.stages.stereo.opencv_matching import SUBPIXELS, Disparity16, Mask, SearchRange

# Reach of the second differences, pixels: a matching block of 3 or 5 pixels blurs a jump by this much.
_DIFFERENCE_RADIUS = 2
# Window in which a missing pixel takes the farthest disparity: a gap next to a foreground object is
# background.
_FILL_WINDOW = 9
# Spread, in pixels, of a pixel without matched neighbours, and the reach of the neighbourhood in pixels.
_ISOLATED_SPREAD = 4
_NEIGHBOUR_RADIUS = 4
# Spread at which the confidence is one half, pixels. Chosen on Middlebury Motorcycle (2014) and checked on
# Cones (2003), and on KITTI by the agreement of depth between consecutive frames.
_HALF_CONFIDENCE_SPREAD = 1.5
# Clipping limit: the confidence is 1 % there already.
_MAX_DEVIATION = 16 * SUBPIXELS


def compute_confidence(
    disparity: Disparity16, residual: NDArray[np.int16], matched: Mask, search: SearchRange
) -> NDArray[np.uint8]:
    """Compute the confidence of each left pixel.

    The confidence is 255 / (1 + (spread / 1.5 px)²), and 0 where not matched.

    Parameters
    ----------
    disparity : (h, w) int16, 1/16 px.
    residual : (h, w) int16, 1/16 px, left–right residual (see `scanloom.stages.stereo.opencv_matching`).
    matched : (h, w), pixels with a measurement.

    Returns
    -------
    (h, w) uint8.
    """
    import cv2

    window = (2 * _NEIGHBOUR_RADIUS + 1, 2 * _NEIGHBOUR_RADIUS + 1)
    alone = cv2.boxFilter(
        (~matched).astype(np.uint8), -1, window, normalize=False, borderType=cv2.BORDER_REPLICATE
    )
    spread = np.minimum(residual, np.int16(SUBPIXELS * _ISOLATED_SPREAD))
    spread += _compute_plane_deviation(disparity, matched, search)
    spread += (
        alone.astype(np.int16) * np.int16(SUBPIXELS * _ISOLATED_SPREAD) // np.int16(window[0] * window[1])
    )
    return np.asarray(np.where(matched, _build_confidence_table().take(spread, mode="clip"), 0), np.uint8)


def _compute_plane_deviation(disparity: Disparity16, matched: Mask, search: SearchRange) -> NDArray[np.int16]:
    """Return the maximum second difference of four directions, clipped."""
    import cv2

    beyond = np.int16(SUBPIXELS * search.end)
    filled = np.where(matched, disparity, beyond)
    farthest = cv2.erode(filled, np.ones((_FILL_WINDOW, _FILL_WINDOW), np.uint8))
    filled = np.where(matched, disparity, farthest)
    size = 2 * _DIFFERENCE_RADIUS + 1
    result = np.zeros_like(disparity)
    for row, column in (
        (_DIFFERENCE_RADIUS, 0),
        (0, _DIFFERENCE_RADIUS),
        (0, 0),
        (0, 2 * _DIFFERENCE_RADIUS),
    ):
        kernel = np.zeros((size, size), np.float32)
        kernel[row, column] = kernel[size - 1 - row, size - 1 - column] = -1
        kernel[_DIFFERENCE_RADIUS, _DIFFERENCE_RADIUS] = 2
        bend = cv2.filter2D(filled, cv2.CV_16S, kernel, borderType=cv2.BORDER_REPLICATE)
        # Clipped first, because the absolute value of the minimum int16 overflows.
        np.maximum(result, np.abs(np.clip(bend, -_MAX_DEVIATION, _MAX_DEVIATION)), out=result)
    return result


def _build_confidence_table() -> NDArray[np.uint8]:
    spread = np.arange(_MAX_DEVIATION + 2 * SUBPIXELS * _ISOLATED_SPREAD + 1) / SUBPIXELS
    return np.asarray(np.round(255 / (1 + (spread / _HALF_CONFIDENCE_SPREAD) ** 2)), np.uint8)
