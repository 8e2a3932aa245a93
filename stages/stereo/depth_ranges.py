"""Depth range of the scene in each view.

A scan can state the range, as a bounding box or as reconstructed points in each view. Otherwise, the range is
estimated from feature matches between views (see scanloom.stages.stereo.triangulation). Without matches, the
scene is assumed to be one object at the intersection of the optical axes. The size of the object is the
median width of the field of view at that point.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import DEPTH_RANGE_UNKNOWN
from scanloom.stages.scans.model.depth_range import DepthRange
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.stereo.codes import DEPTH_RANGE_EMPTY
from scanloom.stages.stereo.posed_views import PosedView

# Margin around a stated box, relative to its diagonal: boxes are tight, and poses inexact.
_BOX_MARGIN_RATIO = 0.02
# Minimum mean squared sine between the optical axes. The intersection of axes within about 3° is
# undetermined.
_MIN_AXIS_SPREAD = math.sin(math.radians(3)) ** 2
# Minimum depth relative to the far end of the box.
_MIN_DEPTH_RATIO = 0.1


def read_stated_ranges(scan: Scan, views: Sequence[PosedView]) -> list[DepthRange | None]:
    """Return the stated depth range of each view, metres, or None."""
    box = widen_scene_box(scan)
    if box is not None:
        return [_compute_box_range(view, box) for view in views]
    return [frame.depth_range for frame in scan.frames]


def assign_depth_ranges(
    scan: Scan,
    views: Sequence[PosedView],
    ranges: Sequence[DepthRange | None],
    min_depth: float | None,
    max_depth: float | None,
) -> list[PosedView]:
    """Assign a depth range to each view.

    Parameters
    ----------
    ranges : known range of each view, metres, or None. A view without range gets the union of all known
        ranges. Without any, the scene is where the optical axes intersect.
    min_depth, max_depth : metres; override the range of every view if given.

    Raises
    ------
    InputError
        If the position of the scene is unknown, or a range is empty.
    """
    if min_depth is not None and max_depth is not None:
        return [replace(view, near=min_depth, far=max_depth) for view in views]
    result = []
    for view, (near, far) in zip(views, _fill_missing_ranges(scan, views, ranges), strict=True):
        lower, upper = min_depth or near, max_depth or far
        if lower >= upper:
            raise InputError(
                DEPTH_RANGE_EMPTY,
                "the depth range {least:.3g} m to {most:.3g} m is empty; correct min_depth or max_depth.",
                scan.folder,
                least=lower,
                most=upper,
            )
        result.append(replace(view, near=lower, far=upper))
    return result


def _fill_missing_ranges(
    scan: Scan, views: Sequence[PosedView], ranges: Sequence[DepthRange | None]
) -> list[DepthRange]:
    known = [one for one in ranges if one is not None]
    if known:
        widest = min(near for near, _ in known), max(far for _, far in known)
        return [one or widest for one in ranges]
    box = estimate_scene_box(views)
    if box is None:
        raise InputError(
            DEPTH_RANGE_UNKNOWN,
            (
                "the position of the scene is unknown: no feature matches agree with the poses, and the "
                "optical axes of the views do not intersect"
            ),
            scan.folder,
            remedy=(
                "check the poses, or set the depth range with depth.min_depth and depth.max_depth (metres)."
            ),
        )
    return [_compute_box_range(view, box) for view in views]


def widen_scene_box(scan: Scan) -> NDArray[np.float64] | None:
    """Return the stated box, (2, 3) metres, with a margin, or None."""
    if scan.bounding_box is None:
        return None
    margin = _BOX_MARGIN_RATIO * float(np.linalg.norm(scan.bounding_box[1] - scan.bounding_box[0]))
    return np.stack([scan.bounding_box[0] - margin, scan.bounding_box[1] + margin])


def estimate_scene_box(views: Sequence[PosedView]) -> NDArray[np.float64] | None:
    """Estimate a cube around the point that all views look at.

    The centre minimises the sum of squared distances to the optical axes. Half of the edge is the median half
    width of the field of view there, along the longer image side.

    Returns
    -------
    (2, 3) corners, metres; None if the axes do not intersect.
    """
    centres = np.stack([view.centre for view in views])
    axes = np.stack([view.world_from_camera[:3, 2] for view in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < _MIN_AXIS_SPREAD * len(views):
        return None
    middle = np.linalg.solve(total, np.einsum("nij,nj->i", across, centres))
    depth = np.einsum("ni,ni->n", middle - centres, axes)
    if np.median(depth) <= 0:
        return None
    shown = [max(v.camera.width / v.camera.fx, v.camera.height / v.camera.fy) / 2 for v in views]
    reach = float(np.median(np.array(shown)[depth > 0] * depth[depth > 0]))
    return np.stack([middle - reach, middle + reach])


def _compute_box_range(view: PosedView, box: NDArray[np.float64]) -> DepthRange:
    """Return the depth range of a box in a view, metres.

    If the box is behind the camera, its distance replaces the maximum depth.
    """
    corners = np.array(list(itertools.product(*box.T)))
    depth = (corners - view.centre) @ view.world_from_camera[:3, 2]
    far = float(depth.max())
    if far <= 0:
        far = float(np.linalg.norm(corners - view.centre, axis=1).max())
    return max(float(depth.min()), _MIN_DEPTH_RATIO * far), far
