"""Diverging colour palettes for signed deviations.

`safe` suits readers with red-green colour blindness.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.raycasting import Floats

PALETTES = ("metrology", "safe")
# RGB levels from low to high; colours between them are interpolated.
_UNDER = {"metrology": ((30, 60, 200), (90, 190, 235)), "safe": ((5, 48, 130), (120, 175, 215))}
_WITHIN = {"metrology": (70, 175, 80), "safe": (240, 240, 240)}
_OVER = {"metrology": ((245, 205, 70), (200, 30, 30)), "safe": ((245, 170, 100), (150, 60, 0))}


def colors_of(distances: Floats, within: float, most: float, palette: str = "metrology") -> NDArray[np.uint8]:
    """Map distances to colours (n, 3).

    Parameters
    ----------
    distances : (n,) metres, signed; unsigned distances are all positive.
    within : metres; smaller distances get the single in-tolerance colour.
    most : metres, above `within`; from this distance the last colour is used.
    palette : one of `PALETTES`.
    """
    shares = ((np.abs(distances) - within) / max(most - within, np.finfo(np.float64).tiny)).clip(0, 1)
    colors = np.tile(np.array(_WITHIN[palette], np.float64), (len(distances), 1))
    under, over = _UNDER[palette], _OVER[palette]
    for is_beyond, near, far in ((distances > within, *over), (distances < -within, under[1], under[0])):
        colors[is_beyond] = _mixed(near, far, shares[is_beyond])
    return np.rint(colors).astype(np.uint8)


def _mixed(first: tuple[int, int, int], last: tuple[int, int, int], shares: Floats) -> Floats:
    return np.asarray((1 - shares[:, None]) * np.array(first) + shares[:, None] * np.array(last))
