"""Depth range of a view, from sparse points that are visible in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DepthRange = tuple[float, float]

# Minimum number of points of a view, minimum valid depth, and percentage of outliers at each end.
_MIN_POINTS = 20
_MIN_DEPTH_M = 1e-9
_OUTLIER_PERCENT = 2.0
# The range is extended at both ends: by this ratio of the disparity span, plus this ratio of the disparity of
# the nearest point.
_DISPARITY_MARGIN_RATIO = 0.25
_NEAR_MARGIN_RATIO = 0.02
# The far limit is at most this multiple of the farthest point; surfaces without points may be farther away.
_MAX_FAR_RATIO = 2.0


def estimate_depth_range(depth: NDArray[np.float64]) -> DepthRange | None:
    """Estimate the (near, far) depth range of a view in metres.

    Parameters
    ----------
    depth : (n,) depths of sparse points in the view, metres.

    Returns
    -------
    None if fewer than 20 points are in front of the camera.
    """
    visible = depth[depth > _MIN_DEPTH_M]
    if len(visible) < _MIN_POINTS:
        return None
    near, far = np.percentile(visible, [_OUTLIER_PERCENT, 100 - _OUTLIER_PERCENT])
    margin = _DISPARITY_MARGIN_RATIO * (1 / near - 1 / far) + _NEAR_MARGIN_RATIO / near
    return float(1 / (1 / near + margin)), float(1 / max(1 / far - margin, 1 / (_MAX_FAR_RATIO * far)))
