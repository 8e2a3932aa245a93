"""Sub-pixel refinement of disparity from image intensities.

The parabola through the aggregated costs of a semi-global matcher is biased towards the disparities its paths
come from. On slanted surfaces the bias reaches a quarter of a pixel with a constant sign, so that fusion does
not average it out. One step of Lucas and Kanade moves each disparity to the best agreement of the images.

Lucas and Kanade, "An iterative image registration technique with an application to stereo vision", 1981.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Window width, px: large enough for sufficient gradients, small enough to keep object edges.
_WINDOW_PX = 9
# Blur of both images, px: bilinear sampling of unblurred images favours whole pixels.
_BLUR_PX = 0.7
# Noise of gradients, grey levels per pixel; weaker gradients shrink the step to zero.
_GRADIENT_NOISE = 0.7
# Maximum step, px; images are not linear beyond it.
_MAX_STEP_PX = 1.0


def refine_disparity(
    left: NDArray[np.uint8], right: NDArray[np.uint8], disparity: NDArray[np.float32], used: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Refine disparities by one Lucas–Kanade step.

    Each pixel of a window is compared at its own disparity, so that slanted surfaces are not biased. Window
    means are subtracted, so that exposure differences have no effect.

    Parameters
    ----------
    left, right : (h, w) uint8, rectified.
    disparity : (h, w) pixels; NaN where missing.
    used : (h, w), pixels to refine; only these contribute to windows.

    Returns
    -------
    (h, w) float32 pixels; unchanged where the step exceeds one pixel.
    """
    import cv2

    first, second = (
        np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR_PX), np.float32)
        for image in (left, right)
    )
    height, width = disparity.shape
    weight = used.astype(np.float32)
    columns = np.arange(width, dtype=np.float32) - np.where(used, disparity, np.float32(0))
    rows = np.repeat(np.arange(height, dtype=np.float32)[:, None], width, axis=1)

    def sample_right(image: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(
            cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
        )

    def sum_in_window(image: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.boxFilter(image, -1, (_WINDOW_PX, _WINDOW_PX), normalize=False), np.float32)

    gradient = (
        np.float32(0.5)
        * (_compute_row_gradient(first) + sample_right(_compute_row_gradient(second)))
        * weight
    )
    difference = (first - sample_right(second)) * weight
    # At least 1, to avoid a division by zero in windows without used pixels.
    count = np.maximum(sum_in_window(weight), 1)
    sum_gradient, sum_difference = sum_in_window(gradient), sum_in_window(difference)
    gradient2 = sum_in_window(gradient * gradient) - sum_gradient * sum_gradient / count
    agreement = sum_in_window(gradient * difference) - sum_gradient * sum_difference / count
    step = -agreement / (gradient2 + np.float32(_WINDOW_PX**2 * _GRADIENT_NOISE**2))
    usable = used & (np.abs(step) <= _MAX_STEP_PX)
    return np.where(usable, disparity + step, disparity)


def _compute_row_gradient(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the derivative along the row, grey levels per pixel."""
    import cv2

    return np.asarray(cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1, scale=0.5), np.float32)
