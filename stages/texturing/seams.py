"""How visible the borders between photos are."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

# Fewer pairs of texels tell nothing.
_LEAST_PAIRS = 100
# Rows at a time: bounds the memory.
_ROWS = 512


class SeamSums:
    """Colour differences between neighbouring texels of images, across borders of photos and within them."""

    def __init__(self) -> None:
        self._sums, self._counts = np.zeros(2), np.zeros(2, np.int64)

    def add(self, image: NDArray[np.float32], label: NDArray[np.int32]) -> None:
        """Add an image.

        Parameters
        ----------
        image : (h, w, 3), levels.
        label : (h, w), the photo that counts most at each texel, -1 for none.
        """
        for start in range(0, len(label), _ROWS):
            rows = slice(start, start + _ROWS + 1)
            _add(image[rows], label[rows], self._sums, self._counts)

    def ratio(self) -> float | None:
        """Return the mean colour difference across borders of photos over that of all other neighbours.

        Returns
        -------
        The ratio of mean distances in CIELAB (CIE 1976), 1 where no border can be seen; None where there are
        hardly any borders.
        """
        if self._counts.min() < _LEAST_PAIRS:
            return None
        across, within = self._sums / self._counts
        return float(across / within) if within > 0 else None


def _add(
    image: NDArray[np.float32], label: NDArray[np.int32], sums: NDArray[np.float64], counts: NDArray[np.int64]
) -> None:
    import cv2

    lab = cv2.split(cv2.cvtColor(image / np.float32(255), cv2.COLOR_RGB2Lab))
    for axis in (0, 1):
        first, second = (np.take(label, range(*ends), axis=axis) for ends in _ends(label.shape[axis]))
        # Channel by channel: NumPy is slow over a last axis of three.
        apart = np.sqrt(functools.reduce(np.add, [np.diff(channel, axis=axis) ** 2 for channel in lab]))
        known = (first >= 0) & (second >= 0)
        same = first == second
        for kind, chosen in enumerate((known & ~same, known & same)):
            sums[kind] += float(apart[chosen].sum(dtype=np.float64))
            counts[kind] += int(np.count_nonzero(chosen))


def _ends(size: int) -> tuple[tuple[int, int], tuple[int, int]]:
    return (0, size - 1), (1, size)
