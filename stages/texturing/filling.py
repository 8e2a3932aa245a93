"""What a texture shows between its charts: their own colours, so that nothing foreign is ever mixed in."""

from __future__ import annotations

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
    source = np.zeros(labels.max() + 1, np.int64)
    source[labels[filled]] = np.flatnonzero(filled)
    near = distance <= padding
    dilated = image.reshape(-1, 3)[source[labels[near]]]
    image[near] = dilated
    pulled = _pull_push(image, near)
    return np.asarray(np.rint(pulled).clip(0, 255), np.uint8)


def _pull_push(image: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill what is not known from coarser and coarser means (Gortler et al. 1996, "The Lumigraph", 4.3)."""
    if known.all():
        return image
    height, width = known.shape
    if height % 2 or width % 2:
        mean = image[known].mean(axis=0) if known.any() else np.zeros(3, np.float32)
        return np.where(known[:, :, None], image, mean)
    halves = (height // 2, 2, width // 2, 2)
    weight = known.reshape(halves).sum(axis=(1, 3))
    sums = np.where(known[:, :, None], image, 0).reshape(*halves, 3).sum(axis=(1, 3))
    coarse = _pull_push((sums / np.maximum(weight, 1)[:, :, None]).astype(np.float32), weight > 0)
    return np.where(known[:, :, None], image, coarse.repeat(2, axis=0).repeat(2, axis=1))
