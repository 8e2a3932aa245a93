"""Rasterization of 2-D triangles to the pixels whose centres they cover.

Both triangles of an edge compute identical intersections with it, so adjacent triangles leave no gap and
share no pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CoveredPixels:
    """Pixels covered by triangles, with one entry per pixel and triangle.

    Attributes
    ----------
    rows, columns : (k,) int64 pixel positions.
    triangles : (k,) int64 triangle indices, ascending.
    weights : (k, 3) float64 barycentric weights of the pixel centre, non-negative, with sum 1.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    triangles: NDArray[np.int64]
    weights: Floats


def rasterize_triangles(corners: Floats, rows: tuple[int, int], width: int) -> CoveredPixels:
    """Rasterize triangles to a range of image rows.

    Parameters
    ----------
    corners : (m, 3, 2) x and y in pixels, of either orientation; the first pixel's centre is at (0.5, 0.5).
    rows : first row, and one past the last row.
    width : image width in pixels; pixels beyond it are dropped.
    """
    low, high = _find_pixel_range(corners[:, :, 1].min(axis=1), corners[:, :, 1].max(axis=1), *rows)
    (triangles,) = np.nonzero(high > low)
    spans = np.repeat(triangles, (high - low)[triangles])
    row = _concatenate_ranges(low[triangles], (high - low)[triangles])
    left, right = _intersect_rows(_sort_corners_by_y(corners), spans, np.asarray(row + 0.5, np.float64))
    first, last = _find_pixel_range(left, right, 0, width)
    lengths = np.maximum(last - first, 0)
    triangle = np.repeat(spans, lengths)
    column = _concatenate_ranges(first, lengths)
    pixel_row = np.repeat(row, lengths)
    centers = np.stack([column + 0.5, pixel_row + 0.5], axis=1)
    return CoveredPixels(pixel_row, column, triangle, _compute_weights(corners, triangle, centers))


def _find_pixel_range(
    low: Floats, high: Floats, first: int, end: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the integers n with low <= n + 0.5 < high.

    The result is the first one, and one past the last.
    """
    bounds = (np.ceil(bound - 0.5).clip(first, end).astype(np.int64) for bound in (low, high))
    return next(bounds), next(bounds)


def _concatenate_ranges(starts: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Concatenate the ranges start, start + 1, … of `counts` values each."""
    before = np.cumsum(counts) - counts
    return np.asarray(np.arange(counts.sum()) + np.repeat(starts - before, counts), np.int64)


def _sort_corners_by_y(corners: Floats) -> Floats:
    """Sort each triangle's corners by y, then x.

    Both triangles of an edge then traverse it in the same direction.
    """
    order = np.lexsort((corners[:, :, 0], corners[:, :, 1]), axis=1)
    return np.take_along_axis(corners, order[:, :, None], axis=1)


def _intersect_rows(corners: Floats, triangles: NDArray[np.int64], y: Floats) -> tuple[Floats, Floats]:
    """Return the x range of horizontal lines in triangles with corners sorted by y."""
    a, b, c = corners[triangles].swapaxes(0, 1)
    is_lower = (y >= b[:, 1])[:, None]
    start, end = np.where(is_lower, b, a), np.where(is_lower, c, b)
    long, short = _interpolate_x(a, c, y), _interpolate_x(start, end, y)
    return np.minimum(long, short), np.maximum(long, short)


def _interpolate_x(start: Floats, end: Floats, y: Floats) -> Floats:
    height = end[:, 1] - start[:, 1]
    share = np.divide(y - start[:, 1], height, out=np.zeros_like(y), where=height > 0)
    return np.asarray(start[:, 0] + share * (end[:, 0] - start[:, 0]))


def _compute_weights(corners: Floats, triangles: NDArray[np.int64], points: Floats) -> Floats:
    a, b, c = corners.swapaxes(0, 1)
    ab, ac = b - a, c - a
    area = (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])[triangles]
    ap = points - a[triangles]
    with np.errstate(divide="ignore", invalid="ignore"):
        v = (ap[:, 0] * ac[triangles, 1] - ap[:, 1] * ac[triangles, 0]) / area
        w = (ab[triangles, 0] * ap[:, 1] - ab[triangles, 1] * ap[:, 0]) / area
    # Rounding can put a centre near an edge slightly outside.
    weights = np.nan_to_num(np.stack([1 - v - w, v, w], axis=1), nan=1 / 3).clip(0, 1)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
