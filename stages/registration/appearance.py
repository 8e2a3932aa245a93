"""Image similarity by vectors of locally aggregated descriptors (VLAD; Jégou et al. 2010)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.features import compute_root_sift
from scanloom.stages.registration.features import Features

_WORD_COUNT = 32
_MAX_SAMPLE_COUNT = 20_000


def compute_similarity(views: Sequence[Features]) -> NDArray[np.float32]:
    """Compute the similarity (n, n) of views by appearance.

    The similarity is 1 for equal views, and 0 if one of both has no features.
    """
    import cv2

    counts = [len(view.points) for view in views]
    if sum(counts) < 4 * _WORD_COUNT:
        return np.zeros((len(views), len(views)), np.float32)
    everything = np.concatenate([view.descriptors for view in views])
    sample = compute_root_sift(everything[:: max(len(everything) // _MAX_SAMPLE_COUNT, 1)])
    cv2.setRNGSeed(0)
    stop = (cv2.TERM_CRITERIA_MAX_ITER, 15, 0.0)
    labels = np.zeros((len(sample), 1), np.int32)
    _, _, centres = cv2.kmeans(sample, _WORD_COUNT, labels, stop, 1, cv2.KMEANS_PP_CENTERS)
    words = np.asarray(centres, np.float32)
    vectors = np.stack([_compute_vlad(compute_root_sift(view.descriptors), words) for view in views])
    return np.asarray(vectors @ vectors.T, np.float32)


def _compute_vlad(descriptors: NDArray[np.float32], words: NDArray[np.float32]) -> NDArray[np.float32]:
    vector = np.zeros_like(words)
    if len(descriptors):
        nearest = (descriptors @ words.T - 0.5 * (words**2).sum(axis=1)).argmax(axis=1)
        np.add.at(vector, nearest, descriptors - words[nearest])
    vector = np.sign(vector) * np.sqrt(np.abs(vector))
    return np.asarray(vector.ravel() / max(float(np.linalg.norm(vector)), 1e-12), np.float32)
