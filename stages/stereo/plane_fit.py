"""The fraction of a plane at which a view and its partners are most alike.

Small windows of the view are compared with the partners' images at the depth that was found, and a little
before and behind it; a parabola through the sums of squared differences has its lowest point at the fraction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.stereo.view_images import Seen

Map = NDArray[np.float32]

# Width of the windows, px, and how far before and behind is looked, steps between planes.
_WINDOW = 5
_ASIDE = 0.5
# Width of the median before, px, and how many planes are near to it.
_MEDIAN, _NEAR = 5, 3
# Squared grey levels a pixel of a window that differs by noise alone: a partner that differs by more, because
# it sees something else, counts less.
_NOISE = 30.0
# A parabola bends by this at least, squared grey levels a pixel, or says nothing.
_LEAST_BEND = 0.5


def refined(main: Seen, partners: Sequence[Seen], inverse: Map, step: float) -> Map:
    """Return inverse depth, (h, w) 1/m, moved by at most a step to where the images agree best.

    Parameters
    ----------
    inverse : (h, w) 1/m, found by a sweep.
    step : 1/m, between its planes.
    """
    import cv2

    def mean(image: Map) -> Map:
        return np.asarray(cv2.boxFilter(image, -1, (_WINDOW, _WINDOW)), np.float32)

    # A pixel alone that is a plane or two off would spoil the windows around it; what is farther may be thin.
    middle = np.asarray(cv2.medianBlur(inverse, _MEDIAN), np.float32)
    inverse = np.where(np.abs(middle - inverse) <= _NEAR * step, middle, inverse)
    height, width = inverse.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    own = main.grey.astype(np.float32)
    own -= mean(own)
    sums = [np.zeros_like(inverse) for _ in range(3)]
    aside = np.float32(_ASIDE * step)
    for partner in partners:
        matrix = main.view.pixels_to(partner.view).astype(np.float32)
        far = [row[0] * columns + row[1] * rows + row[2] for row in matrix]
        image = partner.grey.astype(np.float32)
        costs = []
        for way in (-1, 0, 1):
            at = inverse + way * aside
            x, y, ahead = (line + at * row[3] for line, row in zip(far, matrix, strict=True))
            ahead = np.where(ahead > 0, ahead, np.float32(np.nan))
            place = x / ahead, y / ahead
            seen = np.asarray(
                cv2.remap(
                    image, *place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
                ),
                np.float32,
            )
            off = np.asarray(seen - mean(seen) - own, np.float32)
            costs.append(mean(off * off))
        weight = np.nan_to_num(1 / (np.float32(_NOISE) + costs[0] + costs[1] + costs[2]))
        for total, cost in zip(sums, costs, strict=True):
            total += weight * np.nan_to_num(cost)
    before, here, behind = sums
    bend = before + behind - 2 * here
    fits = bend > np.float32(_LEAST_BEND / _NOISE)
    fraction = np.divide(before - behind, 2 * bend, out=np.zeros_like(bend), where=fits)
    return np.asarray(inverse + aside * np.clip(fraction, -1, 1), np.float32)
