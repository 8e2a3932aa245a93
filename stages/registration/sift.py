"""Points of images that are recognised in others (Lowe, "Distinctive image features", 2004; RootSIFT)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# SIFT's own threshold for the contrast of a point.
_CONTRAST = 0.04
# Grey values from the darkest to the brightest hundredth are stretched to all there are.
_TAILS = 0.01
# A match counts where the second best is this much farther.
_DISTINCT = 0.8
# Pixels that a match may be off the epipolar line; trials; fewer matches tell no fundamental matrix.
_OFF_PX, _TRIALS, _LEAST = 2.0, 1000, 16


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Recognisable points of an image.

    Attributes
    ----------
    pixels : (n, 2) float32, x and y.
    descriptors : (n, 128) uint8.
    strength : (n,) float32.
    """

    pixels: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    strength: NDArray[np.float32]


def keypoints(grey: NDArray[np.uint8], most: int, *, contrast: float = _CONTRAST) -> Keypoints:
    """Return the `most` strongest points of an (h, w) image, of this contrast at least."""
    import cv2

    # Else points lie a quarter of a pixel beside themselves: OpenCV doubles the image off by that.
    sift = cv2.SIFT.create(nfeatures=most, contrastThreshold=contrast, enable_precise_upscale=True)
    found, descriptors = sift.detectAndCompute(_stretched(grey), None)
    if len(found) == 0:
        descriptors = np.zeros((0, 128))
    return Keypoints(
        np.array([one.pt for one in found], np.float32).reshape(-1, 2),
        descriptors.astype(np.uint8),
        np.array([one.response for one in found], np.float32),
    )


def rooted(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return descriptors of unit length whose distances compare better (RootSIFT, Arandjelović 2012)."""
    sums = descriptors.sum(axis=1, keepdims=True, dtype=np.float32)
    return np.asarray(np.sqrt(descriptors / sums.clip(1e-9)), np.float32)


def matches(source: NDArray[np.uint8], target: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return (m, 2) indices of descriptors that are each other's nearest, and distinctly so."""
    from stages import _kernels

    # A kernel, for products of small matrices keep all threads of OpenBLAS waiting for each other.
    return _kernels.match_descriptors(source, target, distinct=_DISTINCT)


def of_one_motion(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which matches, (n, 2) pixels in two images, one fundamental matrix explains: none if too few.

    OpenCV draws its trials from a fixed seed.
    """
    import cv2

    if len(first) < _LEAST:
        return np.zeros(len(first), bool)
    _, found = cv2.findFundamentalMat(first, second, cv2.FM_RANSAC, _OFF_PX, 0.999, _TRIALS)
    kept = np.zeros(len(first), bool) if found is None else np.ravel(found) > 0
    return kept & (np.count_nonzero(kept) >= _LEAST)


def _stretched(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image with its grey values spread, so that dark images have points too."""
    import cv2

    shares = np.cumsum(np.bincount(grey.ravel(), minlength=256)) / grey.size
    low, high = np.searchsorted(shares, (_TAILS, 1 - _TAILS))
    table = np.clip((np.arange(256) - low) * (255 / max(high - low, 1)), 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(grey, table), np.uint8)
