"""SIFT keypoints, their descriptors and matches (Lowe, "Distinctive image features", 2004; RootSIFT)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Default contrast threshold of SIFT in OpenCV.
_CONTRAST = 0.04
# Ratio of the darkest and of the brightest pixels that stretching the contrast may clip.
_CLIPPED_RATIO = 0.01
# Maximum ratio of the distances of the best and the second-best match (ratio test).
_MAX_RATIO = 0.8
# RANSAC of the fundamental matrix: inlier threshold in pixels, trials, and minimum number of inliers.
_INLIER_PX, _TRIALS, _MIN_INLIERS = 2.0, 1000, 16


@dataclass(frozen=True, eq=False)
class Keypoints:
    """SIFT keypoints of an image.

    Attributes
    ----------
    pixels : (n, 2) float32, column and row.
    descriptors : (n, 128) uint8.
    strength : (n,) float32, response of the detector.
    """

    pixels: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    strength: NDArray[np.float32]


def detect_keypoints(
    grey: NDArray[np.uint8], max_count: int, *, contrast: float = _CONTRAST, is_doubled: bool = True
) -> Keypoints:
    """Detect the `max_count` strongest SIFT keypoints of an (h, w) image.

    Parameters
    ----------
    is_doubled : detect details of a pixel in an image of twice the size, as Lowe does, in four times the
        time.
    """
    import cv2

    # Without precise upscaling, OpenCV doubles the image with an offset of a quarter of a pixel.
    sift = cv2.SIFT.create(nfeatures=max_count, contrastThreshold=contrast, enable_precise_upscale=True)
    stretched = stretch_contrast(grey)
    height, width = grey.shape
    if not is_doubled:
        # OpenCV always doubles the image.
        size = (max(width // 2, 1), max(height // 2, 1))
        stretched = np.asarray(cv2.resize(stretched, size, interpolation=cv2.INTER_AREA), np.uint8)
    found, descriptors = sift.detectAndCompute(stretched, None)
    if len(found) == 0:
        descriptors = np.zeros((0, 128))
    scale = np.array((width / stretched.shape[1], height / stretched.shape[0]), np.float32)
    pixels = np.array([one.pt for one in found], np.float32).reshape(-1, 2)
    return Keypoints(
        np.asarray((pixels + 0.5) * scale - 0.5, np.float32) if not is_doubled else pixels,
        descriptors.astype(np.uint8),
        np.array([one.response for one in found], np.float32),
    )


def compute_root_sift(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Convert SIFT descriptors to RootSIFT, of unit length (Arandjelović 2012)."""
    sums = descriptors.sum(axis=1, keepdims=True, dtype=np.float32)
    return np.asarray(np.sqrt(descriptors / sums.clip(1e-9)), np.float32)


def match_descriptors(
    source: NDArray[np.uint8], target: NDArray[np.uint8], *, max_ratio: float = _MAX_RATIO
) -> NDArray[np.int64]:
    """Match descriptors that are mutual nearest neighbours and pass the ratio test.

    Parameters
    ----------
    max_ratio : maximum ratio of the distances of the best and the second-best match.

    Returns
    -------
    (m, 2) indices into `source` and `target`.
    """
    from scanloom.stages import _kernels

    # OpenBLAS is slower: its threads wait for each other in products of small matrices.
    return _kernels.match_descriptors(source, target, max_distance_ratio=max_ratio)


def find_epipolar_inliers(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Find the matches that agree with one fundamental matrix (RANSAC); none if too few agree.

    OpenCV seeds its random trials with a constant, so results are reproducible.

    Parameters
    ----------
    first, second : (n, 2) pixels of the matches in two images.
    """
    import cv2

    if len(first) < _MIN_INLIERS:
        return np.zeros(len(first), bool)
    _, found = cv2.findFundamentalMat(first, second, cv2.FM_RANSAC, _INLIER_PX, 0.999, _TRIALS)
    kept = np.zeros(len(first), bool) if found is None else np.ravel(found) > 0
    return kept & (np.count_nonzero(kept) >= _MIN_INLIERS)


def stretch_contrast(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Stretch the contrast of an (h, w) image, so that dark images have keypoints too."""
    import cv2

    shares = np.cumsum(np.bincount(grey.ravel(), minlength=256)) / grey.size
    low, high = np.searchsorted(shares, (_CLIPPED_RATIO, 1 - _CLIPPED_RATIO))
    table = np.clip((np.arange(256) - low) * (255 / max(high - low, 1)), 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(grey, table), np.uint8)
