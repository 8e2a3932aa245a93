"""Visibility of seams between photos in a texture."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels

# Minimum number of texel pairs for a ratio; fewer are not significant.
_LEAST_PAIRS = 100
# Rows and pairs per batch: bounds memory.
_ROWS, _PAIRS = 512, 1 << 18
# Every `_EVERY`th row of texels is compared with photos.
_EVERY = 4


class SeamSums:
    """Accumulated colour differences of neighbouring texels, across seams and within photos."""

    def __init__(self) -> None:
        self._sums, self._counts = np.zeros(2), np.zeros(2, np.int64)
        self._beside = np.zeros((2, 2))

    def add(
        self, image: NDArray[np.float32], label: NDArray[np.int32], beside: NDArray[np.float64] | None = None
    ) -> None:
        """Add the texel pairs of an image.

        Parameters
        ----------
        image : (h, w, 3), levels.
        label : (h, w), photo with the highest weight at each texel, -1 for none.
        beside : (2, 2), result of `beside_photos` for the image.
        """
        for start in range(0, len(label), _ROWS):
            rows = slice(start, start + _ROWS + 1)
            _add(image[rows], label[rows], self._sums, self._counts)
        if beside is not None:
            self._beside += beside

    def ratio(self) -> float | None:
        """Return the mean colour difference across seams relative to other neighbours.

        Returns
        -------
        Ratio of mean CIELAB distances (CIE 1976): 1 for invisible seams; None if there are too few pairs.
        Photos often end at occlusion boundaries, where the ratio exceeds 1 even without visible seams.
        """
        if self._counts.min() < _LEAST_PAIRS:
            return None
        across, within = self._sums / self._counts
        return float(across / within) if within > 0 else None

    def over_photos(self) -> float | None:
        """Return the seam visibility relative to the photos.

        Returns
        -------
        `ratio` of the texture divided by the same ratio of single photos that show both texels: 1 if texture
        edges are no stronger than edges in the photos. None if there are too few pairs.
        """
        if self.ratio() is None or not (self._beside > 0).all():
            return None
        (across, shown_across), (within, shown_within) = self._beside
        return float(across / shown_across / (within / shown_within))


def beside_photos(
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
    colors, labels : (n, 3) levels and (n,) photos, see `SeamSums.add`.
    pixels, width : (n,) position in the image, row × width + column, and width of the image.

    Returns
    -------
    (2, 2) float64: sums of CIELAB distances. Rows: across seams, within photos. Columns: texture, photos.
    """
    sums = np.zeros((2, 2))
    pairs, shown = points.neighbours(labels, pixels, width=width, every=_EVERY)
    for start in range(0, len(pairs), _PAIRS):
        some = slice(start, start + _PAIRS)
        pair = pairs[some]
        same = labels[pair[:, 0]] == labels[pair[:, 1]]
        for column, both in enumerate((colors[pair], shown[some].astype(np.float32))):
            apart = _apart(_lab(both), axis=1)[:, 0]
            for kind, chosen in enumerate((~same, same)):
                sums[kind, column] += float(apart[chosen].sum(dtype=np.float64))
    return sums


def _lab(image: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    import cv2

    lab = cv2.cvtColor(image / np.float32(255), cv2.COLOR_RGB2Lab)
    return [np.asarray(channel, np.float32) for channel in cv2.split(lab)]


def _apart(lab: list[NDArray[np.float32]], axis: int) -> NDArray[np.float32]:
    """Return the colour distances of neighbours along an axis."""
    # One channel at a time: NumPy is slow over a last axis of length three.
    return np.sqrt(functools.reduce(np.add, [np.diff(channel, axis=axis) ** 2 for channel in lab]))


def _add(
    image: NDArray[np.float32], label: NDArray[np.int32], sums: NDArray[np.float64], counts: NDArray[np.int64]
) -> None:
    lab = _lab(image)
    for axis in (0, 1):
        first, second = (np.take(label, range(*ends), axis=axis) for ends in _ends(label.shape[axis]))
        apart = _apart(lab, axis)
        known = (first >= 0) & (second >= 0)
        same = first == second
        for kind, chosen in enumerate((known & ~same, known & same)):
            sums[kind] += float(apart[chosen].sum(dtype=np.float64))
            counts[kind] += int(np.count_nonzero(chosen))


def _ends(size: int) -> tuple[tuple[int, int], tuple[int, int]]:
    return (0, size - 1), (1, size)
