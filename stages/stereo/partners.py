"""Which other views a view is matched with: those that see the same from a little aside.

The angle under which two views see a point says how exact its depth comes out, and how alike it looks from
both; a few degrees to twenty are useful. Yao et al., "MVSNet", 2018, weigh angles alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.stereo.posed_views import PosedView

# Points of a view at which angle and overlap are measured: so many a row and a column.
_GRID = 8
# Degrees: the best angle, how soon smaller and larger ones get worse, the smallest and the largest taken.
_BEST, _BELOW, _ABOVE = 8.0, 4.0, 12.0
_SMALLEST, _LARGEST = 1.0, 35.0
# A view whose angle at the middle alone is wider is not looked at any closer.
_WIDEST = 60.0
# Of a view's points, the share that the other must see.
_LEAST_OVERLAP = 0.25
# The other view must show the scene in between half and twice this view's scale.
_SCALE = 2.0


def partners(views: Sequence[PosedView], at: int, count: int) -> list[int]:
    """Return the places of at most `count` partners of `views[at]`, the best first; equal ones in order."""
    scores = {int(other): affinity(views[at], views[other]) for other in _candidates(views, at)}
    order = sorted(scores, key=lambda other: -scores[other])
    return [other for other in order[:count] if scores[other] > 0]


def _candidates(views: Sequence[PosedView], at: int) -> NDArray[np.int64]:
    """Return the places of views that look at the point in the middle of a view from an angle that may do."""
    view = views[at]
    point = view.centre + view.middle * view.world_from_camera[:3, 2]
    ways = point - np.stack([other.centre for other in views])
    lengths = np.linalg.norm(ways, axis=1)
    cosines = ways @ ways[at] / np.maximum(lengths * lengths[at], np.finfo(float).tiny)
    found = cosines > math.cos(math.radians(_WIDEST))
    found[at] = False
    return np.flatnonzero(found)


def affinity(first: PosedView, second: PosedView) -> float:
    """Return how well a view suits another as a partner, from 0 (not at all) to 1.

    Measured at points of the first view at two depths, the geometric and the arithmetic mean of its range:
    where little is known of the scene the two are far apart, and either may be nearer to the truth.
    """
    depths = (first.middle, (first.near + first.far) / 2)
    return sum(_affinity_at(first, second, depth) for depth in depths) / len(depths)


def _affinity_at(first: PosedView, second: PosedView, depth: float) -> float:
    columns, rows = np.meshgrid(
        (np.arange(_GRID) + 0.5) * first.camera.width / _GRID,
        (np.arange(_GRID) + 0.5) * first.camera.height / _GRID,
    )
    points = first.to_world(first.rays(columns, rows) * depth)
    u, v, z = second.project(points)
    seen = second.holds(u, v) & (z >= second.near / 2) & (z <= second.far * 2)
    overlap = float(seen.mean())
    if overlap < _LEAST_OVERLAP:
        return 0.0
    scale = float(np.median(z[seen])) / depth * first.camera.fx / second.camera.fx
    here, there = points[seen] - first.centre, points[seen] - second.centre
    cosines = (
        np.einsum("ni,ni->n", here, there) / np.linalg.norm(here, axis=1) / np.linalg.norm(there, axis=1)
    )
    angle = math.degrees(math.acos(min(float(np.median(cosines)), 1.0)))
    if not (_SMALLEST <= angle <= _LARGEST and 1 / _SCALE <= scale <= _SCALE):
        return 0.0
    return overlap * math.exp(-(((angle - _BEST) / (_BELOW if angle < _BEST else _ABOVE)) ** 2) / 2)
