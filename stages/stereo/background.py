"""Where a view shows nothing that could be matched: a backdrop, a clipped sky.

A semi-global matcher fills such places from their rims, in every view alike, so that neither left against
right nor view against view finds out. The objects' rims must not shield what lies beside them, either.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Differences are averaged over so many pixels each way, odd.
_WINDOW = 9


def measurable(image: NDArray[np.uint8], least: float) -> NDArray[np.bool_]:
    """Return where an image has texture all around.

    Parameters
    ----------
    image : (h, w) uint8.
    least : grey levels by which pixels two apart, across or down, must differ in the mean of every window
        that holds the pixel.
    """
    import cv2

    across = np.abs(cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=1))
    down = np.abs(cv2.Sobel(image, cv2.CV_16S, 0, 1, ksize=1))
    total = cv2.boxFilter(
        np.maximum(across, down),
        cv2.CV_32F,
        (_WINDOW, _WINDOW),
        normalize=False,
        borderType=cv2.BORDER_REFLECT,
    )
    found = (total >= least * _WINDOW**2).astype(np.uint8)
    return np.asarray(cv2.erode(found, np.ones((_WINDOW, _WINDOW), np.uint8)) > 0)
