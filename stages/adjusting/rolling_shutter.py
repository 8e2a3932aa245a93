"""Rolling shutter: the camera rotates while image rows are read out (Hedborg et al. 2012).

A pose refers to the middle row. The readout time of a row is -0.5 for the first row and 0.5 for the last row.
Until then the camera has rotated by that fraction of its `Cameras.readout_rotations`. Depth maps are assumed
to have the same readout as colour images.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import compute_motions, transform_points
from scanloom.stages.adjusting.view import AdjustmentView
from scanloom.stages.scans.model.rolling_shutter import compute_readout_time


def compute_readout_times(
    views: Sequence[AdjustmentView], view_indices: NDArray[np.intp], pixels: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Compute the readout times (n,) of pixels in colour images.

    Parameters
    ----------
    view_indices : (n,) index of the view of each pixel.
    pixels : (n, 2).
    """
    heights = np.array([one.size[1] for one in views], np.float64)
    return compute_readout_time(pixels[:, 1], heights[view_indices])


def compute_readout_motions(
    readout_rotations: NDArray[np.float64], readout_times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute motions (n, 4, 4) from camera axes at readout times to the middle row.

    Parameters
    ----------
    readout_rotations : (n, 3) rotations during readout, see `Cameras.readout_rotations`.
    readout_times : (n,) readout times.
    """
    if not readout_rotations.any():
        return np.broadcast_to(np.eye(4), (len(readout_times), 4, 4))
    return compute_motions(
        np.concatenate(
            [np.zeros((len(readout_times), 3)), readout_times[:, None] * readout_rotations], axis=1
        )
    )


def transform_to_readout(
    points: NDArray[np.float64], readout_rotations: NDArray[np.float64], readout_times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Transform points from camera axes at the middle row to readout times.

    Parameters
    ----------
    points : (n, 3) metres.
    readout_rotations : (n, 3) rotations during readout, see `Cameras.readout_rotations`.
    readout_times : (n,) readout times.
    """
    return transform_points(compute_readout_motions(readout_rotations, -readout_times), points)


def transform_to_middle_row(
    points: NDArray[np.float64], readout_rotations: NDArray[np.float64], readout_times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Transform points from camera axes at readout times to the middle row.

    Inverse of `transform_to_readout`, with the same parameters.
    """
    return transform_points(compute_readout_motions(readout_rotations, readout_times), points)
