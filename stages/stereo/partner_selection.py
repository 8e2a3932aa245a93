"""Selection of partner views for matching.

The triangulation angle of two views decides how accurate depth is, and how similar a point looks in both.
Angles from a few degrees to twenty are useful. Yao et al., "MVSNet", 2018, score angles in a similar way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.stereo.posed_views import PosedView

# Grid of sampled points for angle and overlap, per side.
_GRID_SIZE = 8
# Triangulation angles in degrees: the best one, and the standard deviations of the score below and above it;
# then the accepted range.
_BEST_ANGLE_DEG, _SIGMA_BELOW_DEG, _SIGMA_ABOVE_DEG = 8.0, 4.0, 12.0
_MIN_ANGLE_DEG, _MAX_ANGLE_DEG = 1.0, 35.0
# Maximum angle at the central point for a view to be scored at all, degrees.
_MAX_CENTRAL_ANGLE_DEG = 60.0
# Minimum ratio of sampled points that are visible in the partner.
_MIN_OVERLAP = 0.25
# Maximum ratio of image scales, either way.
_MAX_SCALE_RATIO = 2.0


def select_partners(views: Sequence[PosedView], at: int, count: int) -> list[int]:
    """Return the indices of a view's partners, best first.

    Ties are in index order.

    Parameters
    ----------
    at : index of the view.
    count : maximum number of partners.
    """
    scores = {int(other): score_partner(views[at], views[other]) for other in _find_candidates(views, at)}
    order = sorted(scores, key=lambda other: -scores[other])
    return [other for other in order[:count] if scores[other] > 0]


def _find_candidates(views: Sequence[PosedView], at: int) -> NDArray[np.int64]:
    """Return indices of views with a suitable angle to a view.

    The angle is measured at the point in the image centre, at the middle of the depth range.
    """
    view = views[at]
    point = view.centre + view.middle_depth * view.world_from_camera[:3, 2]
    ways = point - np.stack([other.centre for other in views])
    lengths = np.linalg.norm(ways, axis=1)
    cosines = ways @ ways[at] / np.maximum(lengths * lengths[at], np.finfo(float).tiny)
    found = cosines > math.cos(math.radians(_MAX_CENTRAL_ANGLE_DEG))
    found[at] = False
    return np.flatnonzero(found)


def score_partner(first: PosedView, second: PosedView) -> float:
    """Score a view as partner of another, from 0 (unsuitable) to 1.

    The score is the mean over two depths: the geometric and the arithmetic mean of the first view's depth
    range. They differ much if little is known about the scene, and either may be closer to the truth.
    """
    depths = (first.middle_depth, (first.near + first.far) / 2)
    return sum(_score_at_depth(first, second, depth) for depth in depths) / len(depths)


def _score_at_depth(first: PosedView, second: PosedView, depth: float) -> float:
    columns, rows = np.meshgrid(
        (np.arange(_GRID_SIZE) + 0.5) * first.camera.width / _GRID_SIZE,
        (np.arange(_GRID_SIZE) + 0.5) * first.camera.height / _GRID_SIZE,
    )
    points = first.to_world(first.compute_rays(columns, rows) * depth)
    u, v, z = second.project(points)
    seen = second.contains(u, v) & (z >= second.near / 2) & (z <= second.far * 2)
    overlap = float(seen.mean())
    if overlap < _MIN_OVERLAP:
        return 0.0
    scale = float(np.median(z[seen])) / depth * first.camera.fx / second.camera.fx
    here, there = points[seen] - first.centre, points[seen] - second.centre
    cosines = (
        np.einsum("ni,ni->n", here, there) / np.linalg.norm(here, axis=1) / np.linalg.norm(there, axis=1)
    )
    angle = math.degrees(math.acos(min(float(np.median(cosines)), 1.0)))
    if not (_MIN_ANGLE_DEG <= angle <= _MAX_ANGLE_DEG and 1 / _MAX_SCALE_RATIO <= scale <= _MAX_SCALE_RATIO):
        return 0.0
    return overlap * math.exp(
        -(
            ((angle - _BEST_ANGLE_DEG) / (_SIGMA_BELOW_DEG if angle < _BEST_ANGLE_DEG else _SIGMA_ABOVE_DEG))
            ** 2
        )
        / 2
    )
