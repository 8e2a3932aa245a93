"""What a texture shows between its charts: their own colours, so that nothing foreign is ever mixed in."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from stages._opencv import require_opencv


def filled_up(image: NDArray[np.float32], filled: NDArray[np.bool_], padding: int) -> NDArray[np.uint8]:
    """Fill the gaps: near charts with the colour of the nearest texel, beyond with means that grow softer."""
    require_opencv()
    import cv2

    # Labels number the filled texels; each texel gets that of the nearest.
    distance, labels = cv2.distanceTransformWithLabels(
        (~filled).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    source = np.empty(labels.max() + 1, np.int64)
    source[labels[filled]] = np.flatnonzero(filled)
    near = distance <= padding
    gap = near & ~filled
    image[gap] = image.reshape(-1, 3)[source[labels[gap]]]
    _pull_push(image, near)
    return np.asarray(np.rint(image).clip(0, 255), np.uint8)


def _pull_push(image: NDArray[np.float32], known: NDArray[np.bool_]) -> None:
    """Fill what is not known from coarser and coarser means (Gortler et al. 1996, "The Lumigraph", 4.3)."""
    if known.all():
        return
    height, width = known.shape
    if height % 2 or width % 2:
        image[~known] = image[known].mean(axis=0) if known.any() else 0
        return
    shown = np.where(known[:, :, None], image, np.float32(0))
    # Of each pixel of half the size: sums over its four.
    quarters = [(slice(i, None, 2), slice(k, None, 2)) for i in (0, 1) for k in (0, 1)]
    coarse = functools.reduce(np.add, [shown[quarter] for quarter in quarters])
    weight = functools.reduce(np.add, [known[quarter].astype(np.float32) for quarter in quarters])
    coarse /= np.maximum(weight, 1)[:, :, None]
    _pull_push(coarse, weight > 0)
    rows, columns = np.nonzero(~known)
    image[rows, columns] = coarse[rows // 2, columns // 2]
