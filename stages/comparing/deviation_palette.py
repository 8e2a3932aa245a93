"""Diverging colour palettes for signed deviations.

`safe` suits readers with red-green colour blindness.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.raycasting import Floats

PALETTES = ("metrology", "safe")
# RGB levels from low to high; colours between them are interpolated.
_NEGATIVE_COLORS = {"metrology": ((30, 60, 200), (90, 190, 235)), "safe": ((5, 48, 130), (120, 175, 215))}
_TOLERANCE_COLOR = {"metrology": (70, 175, 80), "safe": (240, 240, 240)}
_POSITIVE_COLORS = {"metrology": ((245, 205, 70), (200, 30, 30)), "safe": ((245, 170, 100), (150, 60, 0))}


def colorize_distances(
    distances: Floats, tolerance: float, full_scale: float, palette: str = "metrology"
) -> NDArray[np.uint8]:
    """Map distances to colours (n, 3).

    Parameters
    ----------
    distances : (n,) metres, signed; unsigned distances are all positive.
    tolerance : metres; smaller distances get the single in-tolerance colour.
    full_scale : metres, above `tolerance`; from this distance the last colour is used.
    palette : one of `PALETTES`.
    """
    ratios = ((np.abs(distances) - tolerance) / max(full_scale - tolerance, np.finfo(np.float64).tiny)).clip(
        0, 1
    )
    colors = np.tile(np.array(_TOLERANCE_COLOR[palette], np.float64), (len(distances), 1))
    under, over = _NEGATIVE_COLORS[palette], _POSITIVE_COLORS[palette]
    for is_beyond, near, far in (
        (distances > tolerance, *over),
        (distances < -tolerance, under[1], under[0]),
    ):
        colors[is_beyond] = _mix_colors(near, far, ratios[is_beyond])
    return np.rint(colors).astype(np.uint8)


def _mix_colors(first: tuple[int, int, int], last: tuple[int, int, int], ratios: Floats) -> Floats:
    return np.asarray((1 - ratios[:, None]) * np.array(first) + ratios[:, None] * np.array(last))
