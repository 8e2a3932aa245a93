"""Points of images that are recognised in others (Lowe, "Distinctive image features", 2004; RootSIFT)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# A match counts where the second best is this much farther.
_DISTINCT = 0.8


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Recognisable points of an image.

    Attributes
    ----------
    pixels : (n, 2) float32, x and y.
    descriptors : (n, 128) float32 of unit length.
    """

    pixels: NDArray[np.float32]
    descriptors: NDArray[np.float32]


def keypoints(grey: NDArray[np.uint8], most: int) -> Keypoints:
    """Return the `most` strongest points of an (h, w) image."""
    import cv2

    found, descriptors = cv2.SIFT.create(nfeatures=most).detectAndCompute(grey, None)
    if len(found) == 0:
        return Keypoints(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32))
    rooted = np.sqrt(descriptors / descriptors.sum(axis=1, keepdims=True).clip(1e-9))
    return Keypoints(np.array([one.pt for one in found], np.float32), rooted.astype(np.float32))


def matches(source: NDArray[np.float32], target: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return (m, 2) indices of descriptors that are each other's nearest, and distinctly so."""
    if len(source) == 0 or len(target) < 2:
        return np.zeros((0, 2), np.int64)
    likeness = source @ target.T
    nearest, back = likeness.argmax(axis=1), likeness.argmax(axis=0)
    here = np.arange(len(source))
    best = likeness[here, nearest]
    likeness[here, nearest] = -1
    # Descriptors have unit length: squared distances are 2 - 2 likeness.
    distinct = 2 - 2 * best < _DISTINCT**2 * (2 - 2 * likeness.max(axis=1))
    kept = distinct & (back[nearest] == here)
    return np.column_stack([here[kept], nearest[kept]])
