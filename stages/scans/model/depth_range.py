"""Depth range of a view, from sparse points that are visible in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Range = tuple[float, float]

# Minimum number of points of a view, minimum valid depth, and percentage of outliers at each end.
_ENOUGH = 20
_NEAREST_M = 1e-9
_FALSE = 2.0
# The range is extended at both ends: by this ratio of the disparity span, plus this ratio of the disparity of
# the nearest point.
_BEYOND = 0.25
_BEYOND_NEAREST = 0.02
# The far limit is at most this multiple of the farthest point; surfaces without points may be farther away.
_FARTHEST = 2.0


def range_of_points(depth: NDArray[np.float64]) -> Range | None:
    """Estimate the (near, far) depth range of a view in metres.

    Parameters
    ----------
    depth : (n,) depths of sparse points in the view, metres.

    Returns
    -------
    None if fewer than 20 points are in front of the camera.
    """
    before = depth[depth > _NEAREST_M]
    if len(before) < _ENOUGH:
        return None
    near, far = np.percentile(before, [_FALSE, 100 - _FALSE])
    beyond = _BEYOND * (1 / near - 1 / far) + _BEYOND_NEAREST / near
    return float(1 / (1 / near + beyond)), float(1 / max(1 / far - beyond, 1 / (_FARTHEST * far)))
