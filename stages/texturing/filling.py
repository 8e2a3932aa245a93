"""What a texture shows between its charts: their own colours, so that nothing foreign is ever mixed in."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages._opencv import require_opencv

# Side of the blocks that far gaps are filled by, and the share of one that has to be known.
_BLOCK, _KNOWN = 8, 0.02


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


def fill_gaps(images: Sequence[NDArray[np.uint8]], filled: NDArray[np.bool_], padding: int) -> None:
    """Fill the gaps of images (h, w, c) of one atlas in place, as `filled_up` does, several times as fast.

    Beyond the padding, colours are means of blocks of eight texels and more.
    """
    require_opencv()
    import cv2

    if filled.all() or not filled.any():
        return
    distance, labels = cv2.distanceTransformWithLabels(
        (~filled).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3, labelType=cv2.DIST_LABEL_PIXEL
    )
    source = np.empty(int(labels.max()) + 1, np.int32)
    source[labels[filled]] = np.flatnonzero(filled)
    is_gap = (distance <= padding) & ~filled
    near, taken = np.flatnonzero(is_gap), source[labels[is_gap]]
    far = np.flatnonzero(distance > padding)
    height, width = filled.shape
    row, column = np.divmod(far, width)
    for image in images:
        texels = image.reshape(height * width, -1)
        texels[near] = texels[taken]
        if len(far):
            texels[far] = _coarse(image, distance <= padding)[row // _BLOCK, column // _BLOCK]


def _coarse(image: NDArray[np.uint8], known: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return means of blocks of the known texels; blocks without any get those of coarser ones."""
    import cv2

    size = tuple(-(-side // _BLOCK) for side in known.shape)
    # Blocks at the far edges are continued by nothing.
    grown = (size[0] * _BLOCK, size[1] * _BLOCK)
    weight = np.zeros(grown, np.float32)
    weight[: known.shape[0], : known.shape[1]] = known
    # A channel at a time: rounding before the division would show where little is known.
    total = cv2.resize(weight, size[::-1], interpolation=cv2.INTER_AREA)
    planes = []
    for channel in range(image.shape[2]):
        weight[: known.shape[0], : known.shape[1]] = image[..., channel]
        weight[: known.shape[0], : known.shape[1]] *= known
        planes.append(cv2.resize(weight, size[::-1], interpolation=cv2.INTER_AREA))
    means = np.stack(planes, axis=2) / np.maximum(total, np.float32(1e-3))[:, :, None]
    # To a power of two, which can be halved to the end.
    side = 1 << max(max(size) - 1, 0).bit_length()
    whole = np.zeros((side, side, means.shape[2]), np.float32)
    is_known = np.zeros((side, side), bool)
    whole[: size[0], : size[1]], is_known[: size[0], : size[1]] = means, total > _KNOWN
    _pull_push(whole, is_known)
    return np.asarray(np.rint(whole[: size[0], : size[1]]).clip(0, 255), np.uint8)
