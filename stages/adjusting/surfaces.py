"""Surfaces of two views that must meet: some points that one measures, on the planes that the other does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.adjusting.view import View

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
    rows : (m, 2) of each view's depth map, in its heights: the focal length, and how far the centre is
        below the middle.
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
            np.zeros((0, 2), np.intp), np.zeros(0, np.intp), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2))
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
        rows = np.array([_rows(view) for view in views]).reshape(-1, 2)
        found = cls(couples[kept], couple, together, np.zeros(0), rows)
        return replace(found, late=found.late_where(found.couples[couple, 0], together))

    def late_where(self, view: NDArray[np.intp], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how late (n,) views read points (n, 3) of their own axes; never more than all takes."""
        down, ahead = self.rows[view].T
        z = np.maximum(points[:, 2], 1e-3)
        return np.asarray(np.clip(points[:, 1] / z * down + ahead, -0.5, 0.5))


def _rows(view: View) -> tuple[float, float]:
    height = view.depth.shape[0]
    return view.depth_lens[1] / height, (view.depth_lens[3] + 0.5) / height - 0.5


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
