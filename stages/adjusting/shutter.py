"""A rolling shutter: rows are read one after the other, and the camera turns meanwhile (Hedborg et al. 2012).

A pose is that at the middle row. A row is read later by a share of the time that all take; by then the camera
has turned by that share of its `Cameras.turns`. Depth maps are taken to be read as colour images are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import carried, motion
from scanloom.stages.adjusting.view import View
from scanloom.stages.scans.model.rolling_shutter import late_at


def late_of(
    views: Sequence[View], view: NDArray[np.intp], pixels: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return how late (n,) pixels of the views' colour images are read."""
    heights = np.array([one.size[1] for one in views], np.float64)
    return late_at(pixels[:, 1], heights[view])


def turned(turns: NDArray[np.float64], late: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the motions (n, 4, 4) from the axes of cameras as a row is read to those at the middle row.

    Parameters
    ----------
    turns : (n, 3) of the cameras, see `Cameras.turns`.
    late : (n,) of the rows.
    """
    if not turns.any():
        return np.broadcast_to(np.eye(4), (len(late), 4, 4))
    return motion(np.concatenate([np.zeros((len(late), 3)), late[:, None] * turns], axis=1))


def as_read(
    points: NDArray[np.float64], turns: NDArray[np.float64], late: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points (n, 3) of the axes at the middle row in those as a row is read."""
    return carried(turned(turns, -late), points)


def in_the_middle(
    points: NDArray[np.float64], turns: NDArray[np.float64], late: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points (n, 3) of the axes as a row is read in those at the middle row."""
    return carried(turned(turns, late), points)
