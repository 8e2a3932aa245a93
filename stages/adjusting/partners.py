"""Which views show the same things, told from their poses and depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, inverted_all
from scanloom.stages.adjusting.surfaces import points_of
from scanloom.stages.adjusting.view import View
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.scans.model.scan import Pose

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
        spread = rest[sample_evenly(len(rest), _SPREAD)]
        couples |= {(min(number, int(n)), max(number, int(n))) for n in (*order[:_NEAREST], *spread)}
    return sorted(couples)


def overlaps(views: Sequence[View], cameras: Cameras) -> NDArray[np.float64]:
    """Return (m, m) shares of what views measure that others have before them, the smaller of both ways."""
    shares = np.stack(
        [overlap_of(view, pose, cameras.poses) for view, pose in zip(views, cameras.poses, strict=True)]
    )
    return np.asarray(np.minimum(shares, shares.T))


def overlap_of(view: View, pose: Pose, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share (m,) of what a view measures that the same camera would see from other poses.

    Where it looks another way by more than 60 degrees, that is nothing.
    """
    points = points_of(view, _CELLS)
    if not len(points):
        return np.zeros(len(poses))
    back = inverted_all(poses) @ pose
    there = np.einsum("mij,nj->mni", back[:, :3, :3], points) + back[:, None, :3, 3]
    z = np.where(there[..., 2] > 0.05, there[..., 2], np.nan)
    places = there[..., :2] / z[..., None] * view.depth_lens[:2] + view.depth_lens[2:]
    inside = ((places > 0) & (places < view.depth.shape[::-1])).all(axis=-1)
    alike = back[:, 2, 2] > np.cos(np.radians(_ANGLE))
    return np.asarray(inside.mean(axis=1) * alike)
