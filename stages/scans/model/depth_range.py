"""In which range of depth a view shows points that are known of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Range = tuple[float, float]

# Fewer points of a view say little of its depth. Of more, this share (%) at either end may be false.
_ENOUGH = 20
_NEAREST_M = 1e-9
_FALSE = 2.0
# The scene goes on beyond the others by this share of what they span in disparity, and of their nearest.
_BEYOND = 0.25
_BEYOND_NEAREST = 0.02
# What has no points, far behind them, is looked for up to so many times as far away as the farthest.
_FARTHEST = 2.0


def range_of_points(depth: NDArray[np.float64]) -> Range | None:
    """Return the range of depth of a view from the depths (n,) of points, metres; None if they are few."""
    before = depth[depth > _NEAREST_M]
    if len(before) < _ENOUGH:
        return None
    near, far = np.percentile(before, [_FALSE, 100 - _FALSE])
    beyond = _BEYOND * (1 / near - 1 / far) + _BEYOND_NEAREST / near
    return float(1 / (1 / near + beyond)), float(1 / max(1 / far - beyond, 1 / (_FARTHEST * far)))
