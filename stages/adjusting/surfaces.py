"""Surfaces of two views that must meet: some points that one measures, on the planes that the other does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.view import View
from scanloom.stages.scans.model.rolling_shutter import late_at

# Cells of a view each way that a point is taken from.
_CELLS = 8


@dataclass(frozen=True, eq=False)
class Surfaces:
    """k points, in the order of c couples of views.

    Attributes
    ----------
    couples : (c, 2) the view that measures points, and the one whose surface they are to meet.
    couple : (k,) of each point.
    points : (k, 3) metres, in the axes of the first view as they are read.
    late : (k,) how late that is, see stages/adjusting/shutter.py.
    rows : (m, 3) of each view's depth map, pixels: focal length and centre down its columns, and its height.
    """

    couples: NDArray[np.intp]
    couple: NDArray[np.intp]
    points: NDArray[np.float64]
    late: NDArray[np.float64]
    rows: NDArray[np.float64]

    @classmethod
    def none(cls) -> Surfaces:
        """Return no points."""
        return cls(
            np.zeros((0, 2), np.intp), np.zeros(0, np.intp), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))
        )

    @classmethod
    def of(cls, views: Sequence[View], couples: NDArray[np.intp]) -> Surfaces:
        """Return points of the first view of each couple (c, 2)."""
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
        """Return how late (n,) views read points (n, 3) of their own axes; never more than all takes."""
        fy, cy, height = self.rows[view].T
        rows = points[:, 1] / np.maximum(points[:, 2], 1e-3) * fy + cy
        return np.clip(late_at(rows, height), -0.5, 0.5)


def points_of(view: View, cells: int) -> NDArray[np.float64]:
    """Return points (n, 3) of a view's depth, one of each of `cells` × `cells`, in its axes, metres."""
    height, width = view.depth.shape
    rows, columns = np.mgrid[0:cells, 0:cells]
    rows = ((rows.ravel() + 0.5) * height / cells).astype(int)
    columns = ((columns.ravel() + 0.5) * width / cells).astype(int)
    z = view.depth[rows, columns].astype(np.float64)
    fx, fy, cx, cy = view.depth_lens
    points = np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=1)
    return np.asarray(points[z > 0])
