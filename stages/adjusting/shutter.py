"""Rolling shutter: the camera rotates while image rows are read out (Hedborg et al. 2012).

A pose refers to the middle row. The readout time of a row is -0.5 for the first row and 0.5 for the last row.
Until then the camera has rotated by that fraction of its `Cameras.turns`. Depth maps are assumed to have the
same readout as colour images.
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
    """Compute the readout times (n,) of pixels in colour images.

    Parameters
    ----------
    view : (n,) index of the view of each pixel.
    pixels : (n, 2).
    """
    heights = np.array([one.size[1] for one in views], np.float64)
    return late_at(pixels[:, 1], heights[view])


def turned(turns: NDArray[np.float64], late: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute motions (n, 4, 4) from camera axes at readout times to the middle row.

    Parameters
    ----------
    turns : (n, 3) rotations during readout, see `Cameras.turns`.
    late : (n,) readout times.
    """
    if not turns.any():
        return np.broadcast_to(np.eye(4), (len(late), 4, 4))
    return motion(np.concatenate([np.zeros((len(late), 3)), late[:, None] * turns], axis=1))


def as_read(
    points: NDArray[np.float64], turns: NDArray[np.float64], late: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Transform points from camera axes at the middle row to readout times.

    Parameters
    ----------
    points : (n, 3) metres.
    turns : (n, 3) rotations during readout, see `Cameras.turns`.
    late : (n,) readout times.
    """
    return carried(turned(turns, -late), points)


def in_the_middle(
    points: NDArray[np.float64], turns: NDArray[np.float64], late: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Transform points from camera axes at readout times to the middle row.

    Inverse of `as_read`, with the same parameters.
    """
    return carried(turned(turns, late), points)
