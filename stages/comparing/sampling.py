"""Points spread evenly over the area of a surface."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.raycasting import Floats, Located


def sampled(cumulative: Floats, rows: slice, count: int, rng: np.random.Generator) -> Located:
    """Draw samples `rows` of `count`: one in each of `count` equal shares of the area, in triangle order.

    Neighbours in this order are neighbours in space, which the closest-point search gains from.
    """
    return located(cumulative, *drawn(float(cumulative[-1]), rows, count, rng))


def drawn(total: float, rows: slice, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return of the same samples how much area there is before each (k,), and its weights (k, 3)."""
    number = np.arange(rows.start, rows.stop)
    u, v, w = rng.random((3, len(number)))
    root = np.sqrt(v)  # uniform on a triangle: Osada et al. 2002, "Shape distributions", eq. 1
    return (number + u) * (total / count), np.stack([1 - root, root * (1 - w), root * w], axis=1)


def located(cumulative: Floats, before: Floats, weights: Floats) -> Located:
    """Return the points on the triangles whose area is where so much is before them."""
    return Located(share_of(cumulative, before), weights, np.zeros(len(before)))


def share_of(cumulative: Floats, before: Floats) -> np.ndarray:
    """Return which of the shares that add up like this (n,) begins by so much (k,), and ends after it."""
    found = np.searchsorted(cumulative, before, side="right")
    # The last sample can round up to the full area, behind the last triangle that has any.
    return np.asarray(np.minimum(found, np.searchsorted(cumulative, cumulative[-1])))
