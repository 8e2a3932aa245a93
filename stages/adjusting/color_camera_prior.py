"""Prior on the colour camera from silhouettes.

Matched points barely constrain a shift of all photos, or a shift that differs between near and far points,
because poses absorb both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, compute_camera_jacobian, transform_points
from scanloom.stages.adjusting.lens import compute_projection_derivatives, project_with_distortion

# Standard deviation of the image position measured at silhouettes, pixels.
_SIGMA_PX = 0.3


class SilhouettePrior(NamedTuple):
    """Expected image positions of near and far silhouettes, for one colour camera.

    Attributes
    ----------
    points : (2, k, 3) silhouette points, the near half and the far half; metres, axes of the depth cameras.
    mean_pixels : (2, 2) mean pixel of each half in the photos.
    """

    points: NDArray[np.float64]
    mean_pixels: NDArray[np.float64]


def create_silhouette_prior(points: NDArray[np.float64], cameras: Cameras) -> SilhouettePrior:
    """Create a prior that holds the colour camera at its current state.

    Parameters
    ----------
    points : (n, 3) silhouette points, metres, axes of the depth cameras.
    cameras : cameras with one common colour camera.
    """
    order = np.argsort(points[:, 2], kind="stable")
    half = len(points) // 2
    groups = points[np.stack([order[:half], order[half : 2 * half]])]
    return SilhouettePrior(groups, np.stack([_project_mean(group, cameras) for group in groups]))


def compute_prior_residuals(prior: SilhouettePrior, cameras: Cameras) -> NDArray[np.float64]:
    """Compute the residuals (4,) of the prior, in standard deviations."""
    middles = np.stack([_project_mean(group, cameras) for group in prior.points])
    return np.asarray((middles - prior.mean_pixels).ravel() / _SIGMA_PX)


def compute_prior_jacobian(prior: SilhouettePrior, cameras: Cameras) -> NDArray[np.float64]:
    """Compute the Jacobian (4, 10) of the prior for the colour camera."""
    rows = []
    for group in prior.points:
        shown = _to_color_camera(group, cameras)
        _, by_point, by_lens = compute_projection_derivatives(shown, cameras.lenses[0])
        rows.append(compute_camera_jacobian(shown, by_point, by_lens).mean(axis=0))
    return np.concatenate(rows) / _SIGMA_PX


def _project_mean(points: NDArray[np.float64], cameras: Cameras) -> NDArray[np.float64]:
    return np.asarray(
        project_with_distortion(_to_color_camera(points, cameras), cameras.lenses[0]).mean(axis=0)
    )


def _to_color_camera(points: NDArray[np.float64], cameras: Cameras) -> NDArray[np.float64]:
    return transform_points(np.broadcast_to(cameras.color_from_depth[0], (len(points), 4, 4)), points)
