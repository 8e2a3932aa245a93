"""What holds the colour camera beside the depth cameras where outlines of things say that it is.

Points that are matched hardly tell a shift of all photos, nor how that differs between near and far: poses
give way to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, by_camera, carried
from scanloom.stages.adjusting.lens import derivatives, project

# How well outlines tell where photos are, pixels.
_DEVIATION = 0.3


class Anchor(NamedTuple):
    """Where a colour camera, one for all views, shows outlines.

    Attributes
    ----------
    points : (2, k, 3) of near and of far outlines, metres, axes of the depth cameras.
    middles : (2, 2) pixels, the means of where photos show these.
    """

    points: NDArray[np.float64]
    middles: NDArray[np.float64]


def anchor_of(points: NDArray[np.float64], cameras: Cameras) -> Anchor:
    """Return what holds a colour camera where it is, by outlines (n, 3)."""
    order = np.argsort(points[:, 2], kind="stable")
    half = len(points) // 2
    groups = points[np.stack([order[:half], order[half : 2 * half]])]
    return Anchor(groups, np.stack([_middle(group, cameras) for group in groups]))


def off_anchor(anchor: Anchor, cameras: Cameras) -> NDArray[np.float64]:
    """Return how far a colour camera is from there, (4,) standard deviations."""
    middles = np.stack([_middle(group, cameras) for group in anchor.points])
    return np.asarray((middles - anchor.middles).ravel() / _DEVIATION)


def anchor_rows(anchor: Anchor, cameras: Cameras) -> NDArray[np.float64]:
    """Return how that changes with a step of the colour camera, (4, 10)."""
    rows = []
    for group in anchor.points:
        shown = _shown(group, cameras)
        _, by_point, by_lens = derivatives(shown, cameras.lenses[0])
        rows.append(by_camera(shown, by_point, by_lens).mean(axis=0))
    return np.concatenate(rows) / _DEVIATION


def _middle(points: NDArray[np.float64], cameras: Cameras) -> NDArray[np.float64]:
    return np.asarray(project(_shown(points, cameras), cameras.lenses[0]).mean(axis=0))


def _shown(points: NDArray[np.float64], cameras: Cameras) -> NDArray[np.float64]:
    return carried(np.broadcast_to(cameras.color_from_depth[0], (len(points), 4, 4)), points)
