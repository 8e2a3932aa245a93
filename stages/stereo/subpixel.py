"""Sub-pixel disparity from the images themselves.

The parabola through a semi-global matcher's summed costs is drawn towards the disparities its paths come
from: on slanted surfaces it is off by up to a quarter of a pixel, the same way everywhere, so that fusion
does not average it out. One step of Lucas and Kanade, "An iterative image registration technique with an
application to stereo vision", 1981, moves each disparity to where the images themselves agree best.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Half a dozen pixels each way hold enough gradient; more would blur edges of objects.
_WINDOW = 9
# Blur of both images, px: bilinear sampling of unblurred ones prefers whole pixels.
_BLUR = 0.7
# Gradients weaker than this many grey levels a pixel are noise, and draw the step towards zero.
_NOISE = 0.7
# A longer step leaves the neighbourhood in which an image is nearly linear.
_LONGEST_STEP = 1.0


def refined(
    left: NDArray[np.uint8], right: NDArray[np.uint8], disparity: NDArray[np.float32], used: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Move disparities by the fraction of a pixel at which left and right image agree best around them.

    Each pixel of a window is compared at its own disparity, so that a slant does no harm, and less the
    window's mean, so that a difference in exposure does not either.

    Parameters
    ----------
    left, right : (h, w) uint8, rectified.
    disparity : (h, w) pixels; NaN where there is none.
    used : (h, w), the pixels to move; their neighbours' evidence counts, that of the others does not.
    """
    import cv2

    first, second = (
        np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR), np.float32)
        for image in (left, right)
    )
    height, width = disparity.shape
    weight = used.astype(np.float32)
    columns = np.arange(width, dtype=np.float32) - np.where(used, disparity, np.float32(0))
    rows = np.repeat(np.arange(height, dtype=np.float32)[:, None], width, axis=1)

    def seen(image: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(
            cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
        )

    def around(image: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.boxFilter(image, -1, (_WINDOW, _WINDOW), normalize=False), np.float32)

    slope = np.float32(0.5) * (_slope(first) + seen(_slope(second))) * weight
    difference = (first - seen(second)) * weight
    # All ones wherever a pixel itself is used, so that the mean is never over nothing.
    count = np.maximum(around(weight), 1)
    mean_slope, mean_difference = around(slope), around(difference)
    gradient2 = around(slope * slope) - mean_slope * mean_slope / count
    agreement = around(slope * difference) - mean_slope * mean_difference / count
    step = -agreement / (gradient2 + np.float32(_WINDOW**2 * _NOISE**2))
    usable = used & (np.abs(step) <= _LONGEST_STEP)
    return np.where(usable, disparity + step, disparity)


def _slope(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the derivative along the row, grey levels a pixel."""
    import cv2

    return np.asarray(cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1, scale=0.5), np.float32)
