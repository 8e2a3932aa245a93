"""Statistics of sampled frames before fusion: depth range, depth noise, surface area."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.frames.projection import project
from scanloom.stages.scans.model.scan import DepthImage

_PIXEL_STRIDE = 4  # pixel stride in rows and columns
_DEPTH_BINS = 8


@dataclass(frozen=True)
class DepthNoise:
    """Noise model of depth, along the surface normal.

    The standard deviation at depth z is constant + quadratic · z², metres. The quadratic term models
    triangulation (stereo, structured light). The constant term includes pose errors.
    """

    constant: float = 0.0
    quadratic: float = 0.0

    def compute_deviation(self, depth: float) -> float:
        """Return the standard deviation at a depth, both in metres."""
        return self.constant + self.quadratic * depth**2

    def find_depth_limit(self, deviation: float) -> float:
        """Return the depth at which the standard deviation reaches `deviation`.

        Both are in metres. The result is inf if depth noise is constant.
        """
        if self.quadratic == 0:
            return math.inf
        return math.sqrt(max(deviation - self.constant, 0) / self.quadratic)


@dataclass(frozen=True)
class SceneStatistics:
    """Statistics of the sampled frames.

    Attributes
    ----------
    median_depth, far_depth, max_depth : median depth, its 98 % quantile and its maximum, metres.
    pixel_spacing : distance of measured pixels on a fronto-parallel surface at median depth, metres.
    noise : depth noise.
    area : rough lower bound of the observed surface area, square metres.
    """

    median_depth: float
    far_depth: float
    max_depth: float
    pixel_spacing: float
    noise: DepthNoise
    area: float


def compute_scene_statistics(views: Sequence[PosedDepth], noise: DepthNoise) -> SceneStatistics:
    """Compute statistics of sampled views whose noise is known."""
    depth = np.concatenate([_select_valid_depth(view, _PIXEL_STRIDE) for view in views])
    if not len(depth):  # a small crop may fall between the strided pixels
        depth = np.concatenate([_select_valid_depth(view, 1) for view in views])
    median, far = (float(z) for z in np.percentile(depth, [50, 98]))
    spacing = float(
        np.median(
            [
                median / view.camera.fx / math.sqrt(_compute_valid_density(view.surface.depth))
                for view in views
            ]
        )
    )
    return SceneStatistics(
        median_depth=median,
        far_depth=far,
        max_depth=float(depth.max()),
        pixel_spacing=spacing,
        noise=noise,
        area=_estimate_area(views, median / 20),
    )


def _select_valid_depth(view: PosedDepth, step: int) -> NDArray[np.float32]:
    depth = view.surface.depth[::step, ::step]
    return depth[depth > 0]


def _compute_valid_density(depth: DepthImage) -> float:
    """Return the ratio of valid pixels in the neighbourhood of valid pixels.

    It is below 1 if the sensor omits pixels.
    """
    import cv2

    valid = (depth > 0).astype(np.float32)
    return float(cv2.blur(valid, (5, 5))[valid > 0].mean())


def _estimate_area(views: Sequence[PosedDepth], cell: float) -> float:
    """Estimate the surface area, square metres.

    Counts the occupied cells of a coarse grid, times the area of a cell face.
    """
    cells = np.concatenate([_find_occupied_cells(view.unproject_grid(_PIXEL_STRIDE), cell) for view in views])
    return len(np.unique(cells)) * cell**2


def _find_occupied_cells(points: NDArray[np.float64], cell: float) -> NDArray[np.int64]:
    """Return the sorted keys of occupied grid cells.

    Keys are unique if points are less than a million cells apart.
    """
    x, y, z = np.floor(points / cell).astype(np.int64).T
    return np.unique((x << 42) + (y << 21) + z)


def estimate_noise(pairs: Sequence[tuple[PosedDepth, PosedDepth | None]]) -> DepthNoise:
    """Estimate depth noise by comparing each view with its neighbour, if any."""
    found = [_compare_views(a, b) for a, b in pairs if b is not None]
    depth = np.concatenate([z for z, _ in found]) if found else np.zeros(0)
    difference = np.concatenate([d for _, d in found]) if found else np.zeros(0)
    if len(depth) < 100 * _DEPTH_BINS:
        return DepthNoise()
    edges = np.quantile(depth, np.linspace(0, 1, _DEPTH_BINS + 1))
    which = np.searchsorted(edges[1:-1], depth)
    z, deviation = np.array(
        # 1.4826 converts a median absolute deviation to a standard deviation of a normal distribution.
        [
            (depth[which == k].mean(), 1.4826 / math.sqrt(2) * np.median(np.abs(difference[which == k])))
            for k in range(_DEPTH_BINS)
            if (which == k).any()
        ]
    ).T
    # Relative errors, because absolute ones would let the farthest bin dominate.
    weight = 1 / np.maximum(deviation, 1e-3 * z)
    return DepthNoise(*_fit_two_terms(np.stack([weight, weight * z**2], axis=1), weight * deviation))


def _fit_two_terms(terms: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[float, float]:
    """Fit non-negative coefficients of two terms by least squares.

    Solved directly, because importing SciPy for NNLS takes longer than sampling a scan.

    Parameters
    ----------
    terms : (n, 2).
    values : (n,).
    """
    (one, two), _, rank, _ = np.linalg.lstsq(terms, values, rcond=None)
    if rank == 2 and one >= 0 and two >= 0:
        return float(one), float(two)
    # A coefficient would be negative: fit each term alone, and keep the better one.
    alone = np.maximum(terms.T @ values, 0) / np.maximum((terms**2).sum(axis=0), np.finfo(float).tiny)
    off = ((terms * alone - values[:, None]) ** 2).sum(axis=0)
    return (float(alone[0]), 0.0) if off[0] <= off[1] else (0.0, float(alone[1]))


def _compare_views(a: PosedDepth, b: PosedDepth) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Reproject points of `a` into `b`.

    Returns
    -------
    Depth (n,) in `b`, and the difference (n,) of both measurements along the surface normal, metres.
    """
    seen = (a.unproject_grid(_PIXEL_STRIDE) - b.pose[:3, 3]) @ b.pose[:3, :3]
    seen = seen[seen[:, 2] > 0]
    camera = b.camera
    column, row = map(np.rint, project(seen, camera))
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    column, row, predicted = column[inside].astype(int), row[inside].astype(int), seen[inside, 2]
    measured = b.surface.depth[row, column]
    # Differences above 5 % mean occlusion.
    same = (measured > 0) & (np.abs(measured - predicted) < 0.05 * predicted)
    oblique = b.surface.obliqueness[row, column]
    return predicted[same], ((measured - predicted) / oblique)[same]
