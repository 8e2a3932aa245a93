"""How visible the borders between photos are."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels

# Fewer pairs of texels tell nothing.
_LEAST_PAIRS = 100
# Rows, and pairs, at a time: bounds the memory.
_ROWS, _PAIRS = 512, 1 << 18
# Of so many rows of texels one is compared with photos.
_EVERY = 4


class SeamSums:
    """Colour differences between neighbouring texels of images, across borders of photos and within them."""

    def __init__(self) -> None:
        self._sums, self._counts = np.zeros(2), np.zeros(2, np.int64)
        self._beside = np.zeros((2, 2))

    def add(
        self, image: NDArray[np.float32], label: NDArray[np.int32], beside: NDArray[np.float64] | None = None
    ) -> None:
        """Add an image.

        Parameters
        ----------
        image : (h, w, 3), levels.
        label : (h, w), the photo that counts most at each texel, -1 for none.
        beside : what `beside_photos` says of it.
        """
        for start in range(0, len(label), _ROWS):
            rows = slice(start, start + _ROWS + 1)
            _add(image[rows], label[rows], self._sums, self._counts)
        if beside is not None:
            self._beside += beside

    def ratio(self) -> float | None:
        """Return the mean colour difference across borders of photos over that of all other neighbours.

        Returns
        -------
        The ratio of mean distances in CIELAB (CIE 1976), 1 where no border can be seen; None where there are
        hardly any borders. Photos often end where things do: then it is more without any seam.
        """
        if self._counts.min() < _LEAST_PAIRS:
            return None
        across, within = self._sums / self._counts
        return float(across / within) if within > 0 else None

    def over_photos(self) -> float | None:
        """Return that ratio over the one that photos have, each of the same neighbours, themselves.

        Returns
        -------
        1 where borders are seen no more than what is there in the photos; None where there are hardly any.
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
    """Return how neighbouring texels differ, and how one photo shows them.

    Parameters
    ----------
    points : the surface points, with what photos show of each.
    colors, labels : (n, 3) levels and (n,), see `SeamSums.add`.
    pixels, width : where they are in an image, row × width + column.

    Returns
    -------
    (2, 2): sums of distances in CIELAB, of texels and of photos, across borders and within them.
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
    """Return how far neighbours along an axis are apart."""
    # Channel by channel: NumPy is slow over a last axis of three.
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
