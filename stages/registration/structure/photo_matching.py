"""Feature matches between photos.

All pairs of photos are compared by few features first. Only pairs with many common features are matched
completely (preemptive matching; Wu, "Towards linear-time incremental structure from motion", 2013).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.features import match_descriptors
from scanloom.stages.progress import Progress
from scanloom.stages.registration.structure.photo_features import PhotoFeatures
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered

# Features of each photo in the comparison of all pairs.
_PREEMPTIVE_FEATURES = 400
# Candidate partners per photo: those with the most common features, and the next photos by name.
_MAX_PARTNERS, _NEXT_PHOTOS = 24, 4


def select_candidate_pairs(photos: Sequence[PhotoFeatures], progress: Progress) -> list[tuple[int, int]]:
    """Select the pairs of photos that may show the same surfaces; all pairs of up to 25 photos.

    Parameters
    ----------
    progress : called with the number of finished photos and of all photos.

    Returns
    -------
    Sorted pairs of indices, the smaller index first.
    """
    count = len(photos)
    if count <= _MAX_PARTNERS + 1:
        return list(itertools.combinations(range(count), 2))
    few = [photo.descriptors[:_PREEMPTIVE_FEATURES] for photo in photos]
    shared = np.zeros((count, count), np.int64)

    def count_shared(first: int) -> list[int]:
        return [len(match_descriptors(few[first], few[second])) for second in range(first + 1, count)]

    threads = get_worker_count()
    rows = map_ordered(count_shared, range(count), threads=threads, max_pending=2 * threads)
    for first, row in enumerate(rows):
        shared[first, first + 1 :] = row
        progress(first + 1, count)
    shared += shared.T
    pairs = {
        (first, second)
        for first in range(count)
        for second in range(first + 1, min(first + 1 + _NEXT_PHOTOS, count))
    }
    for first in range(count):
        for second in np.argsort(-shared[first], kind="stable")[:_MAX_PARTNERS].tolist():
            if second != first and shared[first, second] > 0:
                pairs.add((min(first, second), max(first, second)))
    return sorted(pairs)


def match_photos(
    photos: Sequence[PhotoFeatures], pairs: Sequence[tuple[int, int]], max_ratio: float
) -> Iterator[tuple[tuple[int, int], NDArray[np.int64]]]:
    """Match the features of pairs of photos.

    Parameters
    ----------
    max_ratio : maximum ratio of the distances of the best and the second-best match.

    Yields
    ------
    The pair, and (m, 2) indices of features in its first and second photo.
    """
    threads = get_worker_count()

    def match_pair(pair: tuple[int, int]) -> NDArray[np.int64]:
        first, second = (photos[index].descriptors for index in pair)
        return match_descriptors(first, second, max_ratio=max_ratio)

    yield from zip(
        pairs, map_ordered(match_pair, pairs, threads=threads, max_pending=2 * threads), strict=True
    )
