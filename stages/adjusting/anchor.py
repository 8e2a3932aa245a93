"""Prior on the colour camera from silhouettes.

Matched points barely constrain a shift of all photos, or a shift that differs between near and far points,
because poses absorb both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, by_camera, carried
from scanloom.stages.adjusting.lens import derivatives, project

# Standard deviation of the image position measured at silhouettes, pixels.
_DEVIATION = 0.3


class Anchor(NamedTuple):
    """Expected image positions of near and far silhouettes, for one colour camera.

    Attributes
    ----------
    points : (2, k, 3) silhouette points, the near half and the far half; metres, axes of the depth cameras.
    middles : (2, 2) mean pixel of each half in the photos.
    """

    points: NDArray[np.float64]
    middles: NDArray[np.float64]


def anchor_of(points: NDArray[np.float64], cameras: Cameras) -> Anchor:
    """Create a prior that holds the colour camera at its current state.

    Parameters
    ----------
    points : (n, 3) silhouette points, metres, axes of the depth cameras.
    cameras : cameras with one common colour camera.
    """
    order = np.argsort(points[:, 2], kind="stable")
    half = len(points) // 2
    groups = points[np.stack([order[:half], order[half : 2 * half]])]
    return Anchor(groups, np.stack([_middle(group, cameras) for group in groups]))


def off_anchor(anchor: Anchor, cameras: Cameras) -> NDArray[np.float64]:
    """Compute the residuals (4,) of the prior, in standard deviations."""
    middles = np.stack([_middle(group, cameras) for group in anchor.points])
    return np.asarray((middles - anchor.middles).ravel() / _DEVIATION)


def anchor_rows(anchor: Anchor, cameras: Cameras) -> NDArray[np.float64]:
    """Compute the Jacobian (4, 10) of the prior for the colour camera."""
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
