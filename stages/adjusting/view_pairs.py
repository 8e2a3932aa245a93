"""Selection of frame pairs to match, by overlap of their views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, invert_poses
from scanloom.stages.adjusting.surface_points import sample_surface_points
from scanloom.stages.adjusting.view import AdjustmentView
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.scans.model.scan import Pose

# Partners of a view: the views with the largest overlap, and views spread evenly over all others that overlap
# enough. Then the minimum overlap ratio.
_NEAREST_COUNT, _SPREAD_COUNT = 5, 5
_MIN_OVERLAP_RATIO = 0.3
# Grid of sample points per view, each way, for the overlap.
_GRID_SIZE = 12
# Maximum angle between viewing directions, degrees; SIFT matches little beyond.
_MAX_ANGLE_DEG = 60.0


def select_view_pairs(overlap: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Select pairs of views to match.

    Parameters
    ----------
    overlap : (m, m) overlap ratios, see `compute_overlap_matrix`.

    Returns
    -------
    Sorted pairs of view indices, each once, the lower index first.
    """
    couples = set()
    for number, row in enumerate(overlap):
        order = np.argsort(-row, kind="stable")
        order = order[(row[order] >= _MIN_OVERLAP_RATIO) & (order != number)]
        rest = order[_NEAREST_COUNT:]
        spread = rest[sample_evenly(len(rest), _SPREAD_COUNT)]
        couples |= {(min(number, int(n)), max(number, int(n))) for n in (*order[:_NEAREST_COUNT], *spread)}
    return sorted(couples)


def compute_overlap_matrix(views: Sequence[AdjustmentView], cameras: Cameras) -> NDArray[np.float64]:
    """Compute the overlap ratios (m, m) of views.

    Each is the smaller of both directions, see `compute_view_overlap`.
    """
    shares = np.stack(
        [
            compute_view_overlap(view, pose, cameras.poses)
            for view, pose in zip(views, cameras.poses, strict=True)
        ]
    )
    return np.asarray(np.minimum(shares, shares.T))


def compute_view_overlap(
    view: AdjustmentView, pose: Pose, other_poses: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the overlap of a view with other poses of its camera.

    Parameters
    ----------
    pose : (4, 4) world_from_camera of the view.
    other_poses : (m, 4, 4) the other poses.

    Returns
    -------
    (m,) ratio of sampled points visible from the other pose; 0 if viewing directions differ by more than 60°.
    """
    points = sample_surface_points(view, _GRID_SIZE)
    if not len(points):
        return np.zeros(len(other_poses))
    back = invert_poses(other_poses) @ pose
    there = np.einsum("mij,nj->mni", back[:, :3, :3], points) + back[:, None, :3, 3]
    z = np.where(there[..., 2] > 0.05, there[..., 2], np.nan)
    places = there[..., :2] / z[..., None] * view.depth_lens[:2] + view.depth_lens[2:]
    inside = ((places > 0) & (places < view.depth.shape[::-1])).all(axis=-1)
    alike = back[:, 2, 2] > np.cos(np.radians(_MAX_ANGLE_DEG))
    return np.asarray(inside.mean(axis=1) * alike)
