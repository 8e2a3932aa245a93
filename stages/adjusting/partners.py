"""Selection of frame pairs to match, by overlap of their views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, inverted_all
from scanloom.stages.adjusting.surfaces import points_of
from scanloom.stages.adjusting.view import View
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.scans.model.scan import Pose

# Partners of a view: the views with the largest overlap, and views spread evenly over all others that overlap
# enough. Then the minimum overlap ratio.
_NEAREST, _SPREAD = 5, 5
_LEAST_OVERLAP = 0.3
# Grid of sample points per view, each way, for the overlap.
_CELLS = 12
# Maximum angle between viewing directions, degrees; SIFT matches little beyond.
_ANGLE = 60.0


def partners(overlap: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Select pairs of views to match.

    Parameters
    ----------
    overlap : (m, m) overlap ratios, see `overlaps`.

    Returns
    -------
    Sorted pairs of view indices, each once, the lower index first.
    """
    couples = set()
    for number, row in enumerate(overlap):
        order = np.argsort(-row, kind="stable")
        order = order[(row[order] >= _LEAST_OVERLAP) & (order != number)]
        rest = order[_NEAREST:]
        spread = rest[sample_evenly(len(rest), _SPREAD)]
        couples |= {(min(number, int(n)), max(number, int(n))) for n in (*order[:_NEAREST], *spread)}
    return sorted(couples)


def overlaps(views: Sequence[View], cameras: Cameras) -> NDArray[np.float64]:
    """Compute the overlap ratios (m, m) of views.

    Each is the smaller of both directions, see `overlap_of`.
    """
    shares = np.stack(
        [overlap_of(view, pose, cameras.poses) for view, pose in zip(views, cameras.poses, strict=True)]
    )
    return np.asarray(np.minimum(shares, shares.T))


def overlap_of(view: View, pose: Pose, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the overlap of a view with other poses of its camera.

    Parameters
    ----------
    pose : (4, 4) world_from_camera of the view.
    poses : (m, 4, 4) the other poses.

    Returns
    -------
    (m,) ratio of sampled points visible from the other pose; 0 if viewing directions differ by more than 60°.
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
