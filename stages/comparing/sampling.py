"""Points spread evenly over the area of a surface."""

from __future__ import annotations

import numpy as np

from stages.surface.raycasting import Floats, Located


def sampled(cumulative: Floats, rows: slice, count: int, rng: np.random.Generator) -> Located:
    """Draw samples `rows` of `count`: one in each of `count` equal shares of the area, in triangle order.

    Neighbours in this order are neighbours in space, which the closest-point search gains from.
    """
    number = np.arange(rows.start, rows.stop)
    u, v, w = rng.random((3, len(number)))
    triangles = np.searchsorted(cumulative, (number + u) * (cumulative[-1] / count), side="right")
    # The last share can round up to the full area, behind the last triangle that has any.
    triangles = np.minimum(triangles, np.searchsorted(cumulative, cumulative[-1]))
    root = np.sqrt(v)  # uniform on a triangle: Osada et al. 2002, "Shape distributions", eq. 1
    weights = np.stack([1 - root, root * (1 - w), root * w], axis=1)
    return Located(triangles, weights, np.zeros(len(number)))
