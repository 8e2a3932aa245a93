"""Stratified sampling of points uniformly over the area of a surface."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.raycasting import Floats, Located


def sampled(cumulative: Floats, rows: slice, count: int, rng: np.random.Generator) -> Located:
    """Draw samples `rows` out of `count`, stratified by area.

    The area is divided into `count` equal strata in triangle order, with one sample in each. Consecutive
    samples are close in space, which speeds up closest-point queries.
    """
    return located(cumulative, *drawn(float(cumulative[-1]), rows, count, rng))


def drawn(total: float, rows: slice, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw samples as area offsets (k,) and barycentric weights (k, 3); see `sampled`.

    An area offset is the area of all triangles before the sample, in m².
    """
    number = np.arange(rows.start, rows.stop)
    u, v, w = rng.random((3, len(number)))
    root = np.sqrt(v)  # uniform on a triangle: Osada et al. 2002, "Shape distributions", eq. 1
    return (number + u) * (total / count), np.stack([1 - root, root * (1 - w), root * w], axis=1)


def located(cumulative: Floats, before: Floats, weights: Floats) -> Located:
    """Return the surface points at area offsets `before` (k,)."""
    return Located(share_of(cumulative, before), weights, np.zeros(len(before)))


def share_of(cumulative: Floats, before: Floats) -> np.ndarray:
    """Find the interval (k,) of `cumulative` (n,) that contains each offset.

    Parameters
    ----------
    cumulative : (n,) ascending interval ends.
    before : (k,) offsets.
    """
    found = np.searchsorted(cumulative, before, side="right")
    # Rounding can put the last sample at the full area, beyond the last triangle with a non-zero area.
    return np.asarray(np.minimum(found, np.searchsorted(cumulative, cumulative[-1])))
