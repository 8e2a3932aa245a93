"""In which range of depth each view shows the scene.

The folder may tell: by a bounding box, or by points that a reconstruction found in each view. Else points
that views recognise in each other tell (see scanloom.stages.stereo.recognised). Where there are none, views
are taken to look at one thing: it stands where their optical axes come nearest to each other, and reaches as
far around as the usual view shows.
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
from scanloom.stages.scans.model.depth_range import Range
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.stereo.codes import DEPTH_RANGE_EMPTY
from scanloom.stages.stereo.posed_views import PosedView

# A stated box is tight, and poses are off by a little: it is widened by this share of its diagonal.
_BOX_MARGIN = 0.02
# Optical axes that differ by less than about 3 degrees from one another meet nowhere in particular.
_LEAST_SPREAD = math.sin(math.radians(3)) ** 2
# What is nearer than this share of the distance to the scene's middle is not looked for.
_NEAREST = 0.1


def stated_ranges(scan: Scan, views: Sequence[PosedView]) -> list[Range | None]:
    """Return the range of depth of each view as the folder tells it, metres, or None."""
    box = scene_box(scan)
    if box is not None:
        return [_range_of_box(view, box) for view in views]
    return [frame.depth_range for frame in scan.frames]


def ranged_views(
    scan: Scan,
    views: Sequence[PosedView],
    ranges: Sequence[Range | None],
    min_depth: float | None,
    max_depth: float | None,
) -> list[PosedView]:
    """Return the views with their range of depth.

    Parameters
    ----------
    ranges : metres, of each view, as far as they are known. A view without one may show whatever others do;
        without any, the scene is where the optical axes meet.
    min_depth, max_depth : metres; what is given holds for every view, in place of all that.

    Raises
    ------
    InputError
        If nothing tells where the scene is, or a range is none.
    """
    if min_depth is not None and max_depth is not None:
        return [replace(view, near=min_depth, far=max_depth) for view in views]
    result = []
    for view, (near, far) in zip(views, _filled(scan, views, ranges), strict=True):
        least, most = min_depth or near, max_depth or far
        if least >= most:
            raise InputError(
                DEPTH_RANGE_EMPTY,
                "depth from {least:.3g} m to {most:.3g} m is no range; correct min_depth or max_depth.",
                scan.folder,
                least=least,
                most=most,
            )
        result.append(replace(view, near=least, far=most))
    return result


def _filled(scan: Scan, views: Sequence[PosedView], ranges: Sequence[Range | None]) -> list[Range]:
    known = [one for one in ranges if one is not None]
    if known:
        widest = min(near for near, _ in known), max(far for _, far in known)
        return [one or widest for one in ranges]
    box = estimated_box(views)
    if box is None:
        raise InputError(
            DEPTH_RANGE_UNKNOWN,
            (
                "no points are recognised from view to view where the poses say, and the "
                "views look past each other, so that nothing tells where the scene is"
            ),
            scan.folder,
            remedy=(
                "check the poses, or give the range of depth with depth.min_depth and "
                "depth.max_depth (metres)."
            ),
        )
    return [_range_of_box(view, box) for view in views]


def scene_box(scan: Scan) -> NDArray[np.float64] | None:
    """Return the box the scan states, (2, 3) metres, a little widened, or None."""
    if scan.box is None:
        return None
    margin = _BOX_MARGIN * float(np.linalg.norm(scan.box[1] - scan.box[0]))
    return np.stack([scan.box[0] - margin, scan.box[1] + margin])


def estimated_box(views: Sequence[PosedView]) -> NDArray[np.float64] | None:
    """Return the cube, (2, 3) metres, around what all views look at; None where their axes do not meet.

    Its middle is the point of the least sum of squared distances to the optical axes; half of its edge is
    what half the longer side of an image shows at that distance, in the median.
    """
    centres = np.stack([view.centre for view in views])
    axes = np.stack([view.world_from_camera[:3, 2] for view in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < _LEAST_SPREAD * len(views):
        return None
    middle = np.linalg.solve(total, np.einsum("nij,nj->i", across, centres))
    depth = np.einsum("ni,ni->n", middle - centres, axes)
    if np.median(depth) <= 0:
        return None
    shown = [max(v.camera.width / v.camera.fx, v.camera.height / v.camera.fy) / 2 for v in views]
    reach = float(np.median(np.array(shown)[depth > 0] * depth[depth > 0]))
    return np.stack([middle - reach, middle + reach])


def _range_of_box(view: PosedView, box: NDArray[np.float64]) -> Range:
    """Return the depths between which the corners of a box lie; of the whole way where it is behind."""
    corners = np.array(list(itertools.product(*box.T)))
    depth = (corners - view.centre) @ view.world_from_camera[:3, 2]
    far = float(depth.max())
    if far <= 0:
        far = float(np.linalg.norm(corners - view.centre, axis=1).max())
    return max(float(depth.min()), _NEAREST * far), far
