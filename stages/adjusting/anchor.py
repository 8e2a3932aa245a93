"""What holds the colour camera beside the depth cameras where outlines of things say that it is.

Points that are matched hardly tell a shift of all photos: poses give way to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stages.adjusting.cameras import Cameras, by_camera, carried
from stages.adjusting.lens import derivatives, project

# How well outlines tell where photos are, pixels.
_DEVIATION = 0.3


class Anchor(NamedTuple):
    """Where a colour camera, one for all views, shows outlines.

    Attributes
    ----------
    points : (k, 3) of outlines, metres, axes of the depth cameras.
    middle : (2,) pixels, the mean of where photos show them.
    """

    points: NDArray[np.float64]
    middle: NDArray[np.float64]


def anchor_of(points: NDArray[np.float64], cameras: Cameras) -> Anchor:
    """Return what holds a colour camera where it is."""
    return Anchor(points, _middle(points, cameras))


def off_anchor(anchor: Anchor, cameras: Cameras) -> NDArray[np.float64]:
    """Return how far a colour camera is from there, (2,) standard deviations."""
    return (_middle(anchor.points, cameras) - anchor.middle) / _DEVIATION


def anchor_rows(anchor: Anchor, cameras: Cameras) -> NDArray[np.float64]:
    """Return how that changes with a step of the colour camera, (2, 10)."""
    shown = _shown(anchor.points, cameras)
    _, by_point, by_lens = derivatives(shown, cameras.lenses[0])
    return np.asarray(by_camera(shown, by_point, by_lens).mean(axis=0) / _DEVIATION)


def _middle(points: NDArray[np.float64], cameras: Cameras) -> NDArray[np.float64]:
    return np.asarray(project(_shown(points, cameras), cameras.lenses[0]).mean(axis=0))


def _shown(points: NDArray[np.float64], cameras: Cameras) -> NDArray[np.float64]:
    return carried(np.broadcast_to(cameras.color_from_depth[0], (len(points), 4, 4)), points)
