"""Surface points of frame pairs, for point-to-plane residuals between two views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.unprojection import compute_depth_basis
from scanloom.stages.adjusting.view import AdjustmentView
from scanloom.stages.scans.model.rolling_shutter import compute_readout_time

# Grid of surface points per view, each way.
_GRID_SIZE = 8


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """k surface points, sorted by frame pair.

    Attributes
    ----------
    pair_indices : (c, 2) indices of the view that measures the points, and of the view whose surface the
        points
        should meet.
    pair_of_point : (k,) index of the frame pair of each point.
    points : (k, 3) metres, depth-camera axes of the first view, at the readout time of the point's row.
    readout_times : (k,) readout times of the rows, see stages/adjusting/rolling_shutter.py.
    row_intrinsics : (m, 3) fy, cy and height of the depth map of each view, pixels.
    basis : (k, d) derivatives of the relative depth correction by its d coefficients; d is 0 if the
        correction is not fitted.
    """

    pair_indices: NDArray[np.intp]
    pair_of_point: NDArray[np.intp]
    points: NDArray[np.float64]
    readout_times: NDArray[np.float64]
    row_intrinsics: NDArray[np.float64]
    basis: NDArray[np.float64]

    @classmethod
    def create_empty(cls) -> SurfacePoints:
        """Create an empty set of points."""
        return cls(
            np.zeros((0, 2), np.intp),
            np.zeros(0, np.intp),
            np.zeros((0, 3)),
            np.zeros(0),
            np.zeros((0, 3)),
            np.zeros((0, 0)),
        )

    @classmethod
    def from_views(
        cls,
        views: Sequence[AdjustmentView],
        pair_indices: NDArray[np.intp],
        grid_size: int = _GRID_SIZE,
    ) -> SurfacePoints:
        """Sample surface points of the first view of each frame pair (c, 2).

        `grid_size` is the number of points per view, each way.
        """
        seen = [sample_surface_points(view, grid_size) for view in views]
        points = [seen[first] for first in pair_indices[:, 0]]
        counts = [len(some) for some in points]
        kept = np.array(counts, np.intp) > 0
        couple = np.repeat(np.cumsum(kept) - 1, counts)
        together = np.concatenate([np.zeros((0, 3)), *points])
        rows = np.array([(*view.depth_lens[[1, 3]], view.depth.shape[0]) for view in views], np.float64)
        no_basis = np.zeros((len(together), 0))
        found = cls(pair_indices[kept], couple, together, np.zeros(0), rows, no_basis)
        return replace(
            found, readout_times=found.compute_readout_times(found.pair_indices[couple, 0], together)
        )

    def with_depth_basis(self, views: Sequence[AdjustmentView]) -> SurfacePoints:
        """Return the points with the basis of the depth correction of their views."""
        first = self.pair_indices[self.pair_of_point, 0]
        return replace(self, basis=compute_depth_basis(views, first, self.points))

    def correct_points(self, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points (k, 3) with corrected depth, for coefficients (d,)."""
        if not len(coefficients):
            return self.points
        return np.asarray(self.points * (1 + self.basis @ coefficients)[:, None])

    def compute_readout_times(
        self, view_indices: NDArray[np.intp], points: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Compute the readout times (n,) at which views see points.

        Times are clipped to the image, -0.5 to 0.5.

        Parameters
        ----------
        view_indices : (n,) index of the view of each point.
        points : (n, 3) metres, depth-camera axes of that view.
        """
        fy, cy, height = self.row_intrinsics[view_indices].T
        rows = points[:, 1] / np.maximum(points[:, 2], 1e-3) * fy + cy
        return np.clip(compute_readout_time(rows, height), -0.5, 0.5)


def sample_surface_points(view: AdjustmentView, grid_size: int) -> NDArray[np.float64]:
    """Sample points (n, 3) of a depth map on a regular grid.

    One point per cell of a grid of `grid_size` × `grid_size`, if it has depth; metres, depth-camera axes.
    """
    height, width = view.depth.shape
    rows, columns = np.mgrid[0:grid_size, 0:grid_size]
    rows = ((rows.ravel() + 0.5) * height / grid_size).astype(int)
    columns = ((columns.ravel() + 0.5) * width / grid_size).astype(int)
    z = view.depth[rows, columns].astype(np.float64)
    if view.depth_correction is not None:
        z = view.depth_correction.correct_at(columns * view.depth_step, rows * view.depth_step, z)
    fx, fy, cx, cy = view.depth_lens
    points = np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=1)
    return np.asarray(points[z > 0])
