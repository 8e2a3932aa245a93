"""Sub-plane refinement of plane-sweep depth.

Small windows of the view are compared with the partners' images at three depths: as found by the sweep,
slightly in front and slightly behind. A parabola through the sums of squared differences gives the refined
depth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.stereo.view_images import Seen

Map = NDArray[np.float32]

# Window width, px; offset in front and behind, in plane distances.
_WINDOW = 5
_ASIDE = 0.5
# Width of the median filter before refinement, px; maximum difference that it replaces, in planes.
_MEDIAN, _NEAR = 5, 3
# Noise variance, squared grey levels per pixel of a window. Partners with larger differences are probably
# occluded, and get less weight.
_NOISE = 30.0
# Minimum curvature of the parabola, squared grey levels per pixel; flatter ones are not significant.
_LEAST_BEND = 0.5


def refined(main: Seen, partners: Sequence[Seen], inverse: Map, step: float) -> Map:
    """Refine inverse depth by at most one plane distance.

    Parameters
    ----------
    main, partners : view and partners with their images.
    inverse : (h, w) float32 1/m, from the sweep.
    step : distance between planes, 1/m.

    Returns
    -------
    (h, w) float32 1/m.
    """
    import cv2

    def mean(image: Map) -> Map:
        return np.asarray(cv2.boxFilter(image, -1, (_WINDOW, _WINDOW)), np.float32)

    # Single pixels that are a few planes off would spoil the windows around them; larger differences may be
    # thin objects.
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
