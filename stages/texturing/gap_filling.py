"""Filling of the gaps between charts, against colour bleeding."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv


def fill_gaps_smoothly(
    image: NDArray[np.float32], is_filled: NDArray[np.bool_], padding: int
) -> NDArray[np.uint8]:
    """Fill the gaps of an image around its charts.

    Gaps within the padding copy the nearest texel. Gaps beyond are filled with increasingly smooth means.

    Parameters
    ----------
    image : (h, w, 3) float32, levels; changed in place.
    is_filled : (h, w) bool, texels that have a colour.
    padding : texels around each chart that copy the nearest texel.

    Returns
    -------
    (h, w, 3) uint8.
    """
    distance, source = find_nearest_filled(is_filled)
    near = distance <= padding
    gap = near & ~is_filled
    image[gap] = image.reshape(-1, 3)[source[gap]]
    _pull_push(image, near)
    return np.asarray(np.rint(image).clip(0, 255), np.uint8)


def find_nearest_filled(is_filled: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Find the nearest filled texel of each texel; at least one must be filled.

    Returns
    -------
    Distances (h, w) in texels, and indices (h, w) into the flattened image.
    """
    require_opencv()
    import cv2

    # With DIST_LABEL_PIXEL, each texel gets the label of the nearest filled texel.
    distance, labels = cv2.distanceTransformWithLabels(
        (~is_filled).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    source = np.empty(labels.max() + 1, np.int64)
    source[labels[is_filled]] = np.flatnonzero(is_filled)
    return np.asarray(distance, np.float32), source[labels]


def _pull_push(image: NDArray[np.float32], is_known: NDArray[np.bool_]) -> None:
    """Fill unknown texels by pull-push (Gortler et al. 1996, "The Lumigraph", section 4.3)."""
    if is_known.all():
        return
    height, width = is_known.shape
    if height % 2 or width % 2:
        image[~is_known] = image[is_known].mean(axis=0) if is_known.any() else 0
        return
    shown = np.where(is_known[:, :, None], image, np.float32(0))
    # Sums over the four texels of each texel at half the resolution.
    quarters = [(slice(i, None, 2), slice(k, None, 2)) for i in (0, 1) for k in (0, 1)]
    coarse = functools.reduce(np.add, [shown[quarter] for quarter in quarters])
    weight = functools.reduce(np.add, [is_known[quarter].astype(np.float32) for quarter in quarters])
    coarse /= np.maximum(weight, 1)[:, :, None]
    _pull_push(coarse, weight > 0)
    rows, columns = np.nonzero(~is_known)
    image[rows, columns] = coarse[rows // 2, columns // 2]


def fill_gaps_with_block_means(images: Sequence[NDArray[np.uint8]], is_filled: NDArray[np.bool_]) -> None:
    """Fill the gaps of atlas images (h, w, c) with block means, in place.

    A gap gets the mean of the smallest block of 2, 4, 8 … texels that contains a filled texel. Mip levels
    therefore mix a chart with its own colours only, until a block contains two charts.
    """
    if is_filled.all() or not is_filled.any():
        return
    for image in images:
        _fill_from_blocks(image, is_filled)


def _fill_from_blocks(image: NDArray[np.uint8], known: NDArray[np.bool_]) -> None:
    require_opencv()
    import cv2

    height, width, channels = image.shape
    if height % 2 or width % 2:
        # Pad to an even size: the recursion halves until nothing is empty.
        grown = np.zeros((height + height % 2, width + width % 2, channels), np.uint8)
        is_known = np.zeros(grown.shape[:2], bool)
        grown[:height, :width], is_known[:height, :width] = image, known
        _fill_from_blocks(grown, is_known)
        image[:] = grown[:height, :width]
        return
    mask = known.view(np.uint8)
    size = (width // 2, height // 2)
    # The mean of four texels that are 0 or 4 is the number of filled texels.
    count: NDArray[np.uint8] = np.asarray(cv2.resize(4 * mask, size, interpolation=cv2.INTER_AREA), np.uint8)
    coarse: NDArray[np.uint8] = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    coarse, count = coarse.reshape(*size[::-1], channels), count.reshape(size[::-1])
    rows, columns = np.nonzero((count > 0) & (count < 4))
    sums = np.zeros((len(rows), channels), np.float32)
    for i in (0, 1):
        for k in (0, 1):
            at = 2 * rows + i, 2 * columns + k
            sums += image[at] * mask[at][:, None].astype(np.float32)
    coarse[rows, columns] = np.rint(sums / count[rows, columns][:, None])
    if not count.all():
        _fill_from_blocks(coarse, count > 0)
    back: NDArray[np.uint8] = np.asarray(
        cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8
    )
    gap = (1 - mask)[:, :, None] if channels == 1 else 1 - mask
    cv2.copyTo(back.reshape(image.shape), gap, image)
