"""Stratified sampling of points uniformly over the area of a surface."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.raycasting import ClosestPoints, Floats


def sample_stratified(
    cumulative_areas: Floats, rows: slice, count: int, rng: np.random.Generator
) -> ClosestPoints:
    """Draw samples `rows` out of `count`, stratified by area.

    The area is divided into `count` equal strata in triangle order, with one sample in each. Consecutive
    samples are close in space, which speeds up closest-point queries.
    """
    return locate_on_triangles(
        cumulative_areas, *draw_area_offsets(float(cumulative_areas[-1]), rows, count, rng)
    )


def draw_area_offsets(
    total: float, rows: slice, count: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Draw samples as area offsets (k,) and barycentric weights (k, 3); see `sample_stratified`.

    An area offset is the area of all triangles before the sample, in m².
    """
    number = np.arange(rows.start, rows.stop)
    u, v, w = rng.random((3, len(number)))
    root = np.sqrt(v)  # uniform on a triangle: Osada et al. 2002, "Shape distributions", eq. 1
    return (number + u) * (total / count), np.stack([1 - root, root * (1 - w), root * w], axis=1)


def locate_on_triangles(cumulative_areas: Floats, area_offsets: Floats, weights: Floats) -> ClosestPoints:
    """Return the surface points at area offsets `area_offsets` (k,)."""
    return ClosestPoints(find_intervals(cumulative_areas, area_offsets), weights, np.zeros(len(area_offsets)))


def find_intervals(cumulative: Floats, offsets: Floats) -> np.ndarray:
    """Find the interval (k,) of `cumulative_areas` (n,) that contains each offset.

    Parameters
    ----------
    cumulative : (n,) ascending interval ends.
    offsets : (k,) offsets.
    """
    found = np.searchsorted(cumulative, offsets, side="right")
    # Rounding can put the last sample at the full area, beyond the last triangle with a non-zero area.
    return np.asarray(np.minimum(found, np.searchsorted(cumulative, cumulative[-1])))
