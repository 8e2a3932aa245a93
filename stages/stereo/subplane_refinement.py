"""Sub-plane refinement of plane-sweep depth.

Small windows of the view are compared with the partners' images at three depths: as found by the sweep,
slightly in front and slightly behind. A parabola through the sums of squared differences gives the refined
depth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.stereo.view_images import ViewImage

Map = NDArray[np.float32]

# Window width, px; offset in front and behind, in plane distances.
_WINDOW_PX = 5
_OFFSET_STEPS = 0.5
# Width of the median filter before refinement, px; maximum difference that it replaces, in planes.
_MEDIAN_PX, _MAX_MEDIAN_STEPS = 5, 3
# Noise variance, squared grey levels per pixel of a window. Partners with larger differences are probably
# occluded, and get less weight.
_NOISE_VARIANCE = 30.0
# Minimum curvature of the parabola, squared grey levels per pixel; flatter ones are not significant.
_MIN_CURVATURE = 0.5


def refine_inverse_depth(main: ViewImage, partners: Sequence[ViewImage], inverse: Map, step: float) -> Map:
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

    def average(image: Map) -> Map:
        return np.asarray(cv2.boxFilter(image, -1, (_WINDOW_PX, _WINDOW_PX)), np.float32)

    # Single pixels that are a few planes off would spoil the windows around them; larger differences may be
    # thin objects.
    middle = np.asarray(cv2.medianBlur(inverse, _MEDIAN_PX), np.float32)
    inverse = np.where(np.abs(middle - inverse) <= _MAX_MEDIAN_STEPS * step, middle, inverse)
    height, width = inverse.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    own = main.grey.astype(np.float32)
    own -= average(own)
    sums = [np.zeros_like(inverse) for _ in range(3)]
    offset = np.float32(_OFFSET_STEPS * step)
    for partner in partners:
        matrix = main.view.compute_projection_to(partner.view).astype(np.float32)
        rotated_pixels = [row[0] * columns + row[1] * rows + row[2] for row in matrix]
        image = partner.grey.astype(np.float32)
        costs = []
        for way in (-1, 0, 1):
            at = inverse + way * offset
            x, y, depth_in_partner = (
                line + at * row[3] for line, row in zip(rotated_pixels, matrix, strict=True)
            )
            depth_in_partner = np.where(depth_in_partner > 0, depth_in_partner, np.float32(np.nan))
            position = x / depth_in_partner, y / depth_in_partner
            seen = np.asarray(
                cv2.remap(
                    image, *position, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
                ),
                np.float32,
            )
            off = np.asarray(seen - average(seen) - own, np.float32)
            costs.append(average(off * off))
        weight = np.nan_to_num(1 / (np.float32(_NOISE_VARIANCE) + costs[0] + costs[1] + costs[2]))
        for total, cost in zip(sums, costs, strict=True):
            total += weight * np.nan_to_num(cost)
    before, here, behind = sums
    curvature = before + behind - 2 * here
    fits = curvature > np.float32(_MIN_CURVATURE / _NOISE_VARIANCE)
    fraction = np.divide(before - behind, 2 * curvature, out=np.zeros_like(curvature), where=fits)
    return np.asarray(inverse + offset * np.clip(fraction, -1, 1), np.float32)
