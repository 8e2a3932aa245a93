"""Visibility of seams between photos in a texture."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels

# Minimum number of texel pairs for a ratio; fewer are not significant.
_MIN_PAIRS = 100
# Rows and pairs per batch: bounds memory.
_BATCH_ROWS, _BATCH_PAIRS = 512, 1 << 18
# Every `_ROW_STRIDE`th row of texels is compared with photos.
_ROW_STRIDE = 4


class SeamStatistics:
    """Accumulated colour differences of neighbouring texels, across seams and within photos."""

    def __init__(self) -> None:
        self._sums, self._counts = np.zeros(2), np.zeros(2, np.int64)
        self._neighbour_sums = np.zeros((2, 2))

    def add(
        self,
        image: NDArray[np.float32],
        labels: NDArray[np.int32],
        neighbour_sums: NDArray[np.float64] | None = None,
    ) -> None:
        """Add the texel pairs of an image.

        Parameters
        ----------
        image : (h, w, 3), levels.
        labels : (h, w), photo with the highest weight at each texel, -1 for none.
        neighbour_sums : (2, 2), result of `sum_neighbour_differences` for the image.
        """
        for start in range(0, len(labels), _BATCH_ROWS):
            rows = slice(start, start + _BATCH_ROWS + 1)
            _add_neighbours(image[rows], labels[rows], self._sums, self._counts)
        if neighbour_sums is not None:
            self._neighbour_sums += neighbour_sums

    def compute_ratio(self) -> float | None:
        """Return the mean colour difference across seams relative to other neighbours.

        Returns
        -------
        Ratio of mean CIELAB distances (CIE 1976): 1 for invisible seams; None if there are too few pairs.
        Photos often end at occlusion boundaries, where the ratio exceeds 1 even without visible seams.
        """
        if self._counts.min() < _MIN_PAIRS:
            return None
        across, within = self._sums / self._counts
        return float(across / within) if within > 0 else None

    def compute_ratio_over_photos(self) -> float | None:
        """Return the seam visibility relative to the photos.

        Returns
        -------
        `compute_ratio` of the texture divided by the same ratio of single photos that show both texels: 1 if
        texture edges are no stronger than edges in the photos. None if there are too few pairs.
        """
        if self.compute_ratio() is None or not (self._neighbour_sums > 0).all():
            return None
        (across, shown_across), (within, shown_within) = self._neighbour_sums
        return float(across / shown_across / (within / shown_within))


def sum_neighbour_differences(
    points: _kernels.SurfacePoints,
    colors: NDArray[np.float32],
    labels: NDArray[np.int32],
    pixels: NDArray[np.uint32],
    width: int,
) -> NDArray[np.float64]:
    """Sum the differences of neighbouring texels, in the texture and in single photos.

    Parameters
    ----------
    points : surface points with their photo samples.
    colors, labels : (n, 3) levels and (n,) photos, see `SeamStatistics.add`.
    pixels, width : (n,) position in the image, row × width + column, and width of the image.

    Returns
    -------
    (2, 2) float64: sums of CIELAB distances. Rows: across seams, within photos. Columns: texture, photos.
    """
    sums = np.zeros((2, 2))
    pairs, shown = points.collect_neighbours(labels, pixels, width=width, row_step=_ROW_STRIDE)
    for start in range(0, len(pairs), _BATCH_PAIRS):
        batch = slice(start, start + _BATCH_PAIRS)
        pair = pairs[batch]
        is_within = labels[pair[:, 0]] == labels[pair[:, 1]]
        for column, pair_colors in enumerate((colors[pair], shown[batch].astype(np.float32))):
            distances = _compute_distances(_convert_to_lab(pair_colors), axis=1)[:, 0]
            for kind, chosen in enumerate((~is_within, is_within)):
                sums[kind, column] += float(distances[chosen].sum(dtype=np.float64))
    return sums


def _convert_to_lab(image: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    import cv2

    lab = cv2.cvtColor(image / np.float32(255), cv2.COLOR_RGB2Lab)
    return [np.asarray(channel, np.float32) for channel in cv2.split(lab)]


def _compute_distances(lab: list[NDArray[np.float32]], axis: int) -> NDArray[np.float32]:
    """Return the colour distances of neighbours along an axis."""
    # One channel at a time: NumPy is slow over a last axis of length three.
    return np.sqrt(functools.reduce(np.add, [np.diff(channel, axis=axis) ** 2 for channel in lab]))


def _add_neighbours(
    image: NDArray[np.float32],
    labels: NDArray[np.int32],
    sums: NDArray[np.float64],
    counts: NDArray[np.int64],
) -> None:
    lab = _convert_to_lab(image)
    for axis in (0, 1):
        first, second = (
            np.take(labels, range(*ends), axis=axis) for ends in _get_neighbour_ranges(labels.shape[axis])
        )
        distances = _compute_distances(lab, axis)
        is_known = (first >= 0) & (second >= 0)
        is_within = first == second
        for kind, chosen in enumerate((is_known & ~is_within, is_known & is_within)):
            sums[kind] += float(distances[chosen].sum(dtype=np.float64))
            counts[kind] += int(np.count_nonzero(chosen))


def _get_neighbour_ranges(size: int) -> tuple[tuple[int, int], tuple[int, int]]:
    return (0, size - 1), (1, size)
