"""Which views show the same things, told from their poses and depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.adjusting.cameras import Cameras, inverted_all
from stages.adjusting.view import View

# Partners of a view: some that overlap most, and as many spread among those that overlap enough.
_NEAREST, _SPREAD = 5, 5
_LEAST_OVERLAP = 0.3
# Cells of a view each way that stand for what it shows.
_CELLS = 12
# Directions in which two views look may differ by this angle, degrees; beyond, SIFT recognises little.
_ANGLE = 60.0


def partners(overlap: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return couples of views worth matching, each once, the lower number first."""
    couples = set()
    for number, row in enumerate(overlap):
        order = np.argsort(-row, kind="stable")
        order = order[(row[order] >= _LEAST_OVERLAP) & (order != number)]
        rest = order[_NEAREST:]
        spread = rest[np.unique(np.linspace(0, len(rest) - 1, _SPREAD).round().astype(int))] if len(rest) else []
        couples |= {(min(number, int(n)), max(number, int(n))) for n in (*order[:_NEAREST], *spread)}
    return sorted(couples)


def overlaps(views: Sequence[View], cameras: Cameras) -> NDArray[np.float64]:
    """Return (m, m) shares of what one view measures that the other has before it, the smaller of both ways."""
    count = len(views)
    shares = np.zeros((count, count))
    back = inverted_all(cameras.poses)
    toward = cameras.poses[:, :3, 2]
    for number, view in enumerate(views):
        points = _points(view)
        if not len(points):
            continue
        world = points @ cameras.poses[number, :3, :3].T + cameras.poses[number, :3, 3]
        there = np.einsum("mij,nj->mni", back[:, :3, :3], world) + back[:, None, :3, 3]
        z = np.where(there[..., 2] > 0.05, there[..., 2], np.nan)
        lenses = np.stack([one.depth_lens for one in views])[:, None]
        sizes = np.array([one.depth.shape[::-1] for one in views])[:, None]
        places = there[..., :2] / z[..., None] * lenses[..., :2] + lenses[..., 2:]
        inside = ((places > 0) & (places < sizes)).all(axis=-1)
        alike = toward @ toward[number] > np.cos(np.radians(_ANGLE))
        shares[number] = inside.mean(axis=1) * alike
    return np.minimum(shares, shares.T)


def _points(view: View) -> NDArray[np.float64]:
    """Return points of a view's depth from all over it, in its axes."""
    height, width = view.depth.shape
    rows, columns = np.mgrid[0:_CELLS, 0:_CELLS]
    rows = ((rows.ravel() + 0.5) * height / _CELLS).astype(int)
    columns = ((columns.ravel() + 0.5) * width / _CELLS).astype(int)
    z = view.depth[rows, columns].astype(np.float64)
    fx, fy, cx, cy = view.depth_lens
    points = np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=1)
    return np.asarray(points[z > 0])
