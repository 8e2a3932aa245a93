"""Surface points of frame pairs, for point-to-plane residuals between two views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.view import View
from scanloom.stages.scans.model.rolling_shutter import late_at

# Grid of surface points per view, each way.
_CELLS = 8


@dataclass(frozen=True, eq=False)
class Surfaces:
    """k surface points, sorted by frame pair.

    Attributes
    ----------
    couples : (c, 2) indices of the view that measures the points, and of the view whose surface the points
        should meet.
    couple : (k,) index of the frame pair of each point.
    points : (k, 3) metres, depth-camera axes of the first view, at the readout time of the point's row.
    late : (k,) readout times of the rows, see stages/adjusting/shutter.py.
    rows : (m, 3) fy, cy and height of the depth map of each view, pixels.
    """

    couples: NDArray[np.intp]
    couple: NDArray[np.intp]
    points: NDArray[np.float64]
    late: NDArray[np.float64]
    rows: NDArray[np.float64]

    @classmethod
    def none(cls) -> Surfaces:
        """Create an empty set of points."""
        return cls(
            np.zeros((0, 2), np.intp), np.zeros(0, np.intp), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))
        )

    @classmethod
    def of(cls, views: Sequence[View], couples: NDArray[np.intp]) -> Surfaces:
        """Sample surface points of the first view of each frame pair (c, 2)."""
        seen = [points_of(view, _CELLS) for view in views]
        points = [seen[first] for first in couples[:, 0]]
        counts = [len(some) for some in points]
        kept = np.array(counts, np.intp) > 0
        couple = np.repeat(np.cumsum(kept) - 1, counts)
        together = np.concatenate([np.zeros((0, 3)), *points])
        rows = np.array([(*view.depth_lens[[1, 3]], view.depth.shape[0]) for view in views], np.float64)
        found = cls(couples[kept], couple, together, np.zeros(0), rows)
        return replace(found, late=found.late_where(found.couples[couple, 0], together))

    def late_where(self, view: NDArray[np.intp], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the readout times (n,) at which views see points.

        Times are clipped to the image, -0.5 to 0.5.

        Parameters
        ----------
        view : (n,) index of the view of each point.
        points : (n, 3) metres, depth-camera axes of that view.
        """
        fy, cy, height = self.rows[view].T
        rows = points[:, 1] / np.maximum(points[:, 2], 1e-3) * fy + cy
        return np.clip(late_at(rows, height), -0.5, 0.5)


def points_of(view: View, cells: int) -> NDArray[np.float64]:
    """Sample points (n, 3) of a depth map on a regular grid.

    One point per cell of a grid of `cells` × `cells`, if it has depth; metres, depth-camera axes.
    """
    height, width = view.depth.shape
    rows, columns = np.mgrid[0:cells, 0:cells]
    rows = ((rows.ravel() + 0.5) * height / cells).astype(int)
    columns = ((columns.ravel() + 0.5) * width / cells).astype(int)
    z = view.depth[rows, columns].astype(np.float64)
    fx, fy, cx, cy = view.depth_lens
    points = np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=1)
    return np.asarray(points[z > 0])
