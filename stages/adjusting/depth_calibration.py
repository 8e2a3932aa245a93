"""Self-calibration of depth: prior of the correction, agreement on held-out points, and scale from poses.

The correction is fitted with the poses (Teichman, Miller and Thrun 2013; Basso et al. 2018). Overlapping
depth maps do not constrain a common scale of depth and poses, and smaller lengths have smaller residuals.
So the mean correction is held at zero, and only given poses fix the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import CAMERA_PARAMETER_COUNT, Cameras
from scanloom.stages.adjusting.problem import AdjustmentProblem, AdjustmentState
from scanloom.stages.adjusting.surface_points import SurfacePoints
from scanloom.stages.adjusting.tracks import Tracks
from scanloom.stages.adjusting.view import AdjustmentView
from scanloom.stages.scans.model.depth_correction import (
    COEFFICIENT_COUNT,
    POSITION_COUNT,
    DepthCorrection,
)

# Standard deviations of the coefficients: constant in depth, and linear in depth. Then of the mean
# correction, which is held at zero.
_CONSTANT_SIGMA, _LINEAR_SIGMA, _MEAN_SIGMA = 0.01, 0.005, 1e-5
# Percentage of outliers at each end of the depth range, and minimum ratio of the farthest to the nearest
# depth.
_OUTLIER_PERCENT, _MIN_RANGE_RATIO = 2.0, 1.05
# Subsampling of depth maps for the depth range, pixels.
_RANGE_STRIDE_PX = 16
# Grid of held-out surface points per view, each way. It differs from the grid of the fits.
_HELD_OUT_GRID_SIZE = 7
# Residuals are clipped at this many standard deviations.
_MAX_SIGMAS = 3.0
# Minimum decrease of the mean squared residual of held-out points for an accepted correction: relative, and
# in standard errors over the views. Without any error of depth, the decrease is below 2 %.
_MIN_GAIN_RATIO, _MIN_GAIN_SIGMAS = 0.08, 4.0
# Minimum relative decrease of their median distance. The mean alone can fall at a few places that get worse
# photos: on a table top at 0.5 m, the median stayed at 2.0 mm and held-out photos lost 0.3 dB.
_MIN_MEDIAN_GAIN_RATIO = 0.05
# Minimum number of held-out points and of views with such points.
_MIN_POINT_COUNT, _MIN_VIEW_COUNT = 200, 4
# Minimum deviation of a scale from 1 in standard errors, and maximum plausible deviation.
_MIN_SCALE_SIGMAS, _MAX_SCALE_DEVIATION = 4.0, 0.05


@dataclass(frozen=True)
class DepthAgreement:
    """Agreement of overlapping depth maps at held-out surface points.

    Attributes
    ----------
    before_mm, after_mm : median distance from the surface of the other frame, millimetres, without and with
        the correction.
    gain_ratio : relative decrease of the mean squared distance in standard deviations.
    gain_sigmas : this decrease in standard errors over the views.
    """

    before_mm: float
    after_mm: float
    gain_ratio: float
    gain_sigmas: float

    @property
    def is_clear(self) -> bool:
        """Return True if the correction clearly improves the agreement."""
        return (
            self.gain_ratio > _MIN_GAIN_RATIO
            and self.gain_sigmas > _MIN_GAIN_SIGMAS
            and self.after_mm < (1 - _MIN_MEDIAN_GAIN_RATIO) * self.before_mm
        )

    @property
    def is_promising(self) -> bool:
        """Return True if a fit that has not converged may become clear."""
        return self.gain_ratio > 0.5 * _MIN_GAIN_RATIO


def has_common_depth_camera(views: Sequence[AdjustmentView]) -> bool:
    """Return True if all depth maps have one size and one camera."""
    first = views[0]
    return all(
        view.depth.shape == first.depth.shape
        and view.depth_step == first.depth_step
        and np.array_equal(view.depth_lens, first.depth_lens)
        for view in views
    )


def create_neutral_correction(views: Sequence[AdjustmentView]) -> DepthCorrection | None:
    """Create a correction of zero for the depth range of views; None if the range is too small."""
    depths = np.concatenate(
        [view.depth[::_RANGE_STRIDE_PX, ::_RANGE_STRIDE_PX].ravel() for view in views]
    ).astype(np.float64)
    depths = depths[depths > 0]
    if not len(depths):
        return None
    near, far = (float(value) for value in np.percentile(depths, (_OUTLIER_PERCENT, 100 - _OUTLIER_PERCENT)))
    if far < _MIN_RANGE_RATIO * near:
        return None
    width, height = views[0].full_depth_size
    return DepthCorrection(width, height, near, far, (0.0,) * COEFFICIENT_COUNT)


def compute_depth_precision(basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the inverse covariance (d, d) of the prior on the depth coefficients.

    The mean correction at the surface points is held at zero; `basis` (n, d) has the basis functions there.
    """
    sigmas = np.repeat([_CONSTANT_SIGMA, _LINEAR_SIGMA], POSITION_COUNT)
    mean = basis.mean(axis=0)
    return np.asarray(np.diag(sigmas**-2) + np.outer(mean, mean) / _MEAN_SIGMA**2)


def measure_depth_agreement(
    pair_indices: NDArray[np.intp],
    before: tuple[Sequence[AdjustmentView], Cameras],
    after: tuple[Sequence[AdjustmentView], Cameras],
) -> DepthAgreement | None:
    """Measure the agreement of overlapping depth maps without and with a correction.

    Points of the second view of each pair are compared with the surface of the first view. Fits use points of
    the first view, on another grid.

    Parameters
    ----------
    pair_indices : (c, 2) indices of the views of each pair.
    before, after : views with their depth correction, and their cameras.

    Returns
    -------
    None if too few points are visible in both views.
    """
    first, residuals, distances = zip(
        *(_measure_distances(views, cameras, pair_indices[:, ::-1]) for views, cameras in (before, after)),
        strict=True,
    )
    both = ~(np.isnan(residuals[0]) | np.isnan(residuals[1]))
    view = first[0][both]
    if np.count_nonzero(both) < _MIN_POINT_COUNT:
        return None
    square, other = (np.minimum(one[both] ** 2, _MAX_SIGMAS**2) for one in residuals)
    counts = np.bincount(view)
    used = counts > 0
    if np.count_nonzero(used) < _MIN_VIEW_COUNT:
        return None
    gains = np.bincount(view, square - other)[used] / counts[used]
    before_mm, after_mm = (1000 * float(np.median(np.abs(one[both]))) for one in distances)
    return DepthAgreement(
        before_mm,
        after_mm,
        gain_ratio=float(1 - other.mean() / square.mean()),
        gain_sigmas=float(gains.mean() / (gains.std(ddof=1) / np.sqrt(len(gains)) + 1e-12)),
    )


def _measure_distances(
    views: Sequence[AdjustmentView], cameras: Cameras, pair_indices: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Measure distances of surface points of the first views from the surfaces of the second views.

    Returns
    -------
    Index of the first view (k,), and distances (k,) in standard deviations and in metres; NaN without
    surface.
    """
    surfaces = SurfacePoints.from_views(views, pair_indices, _HELD_OUT_GRID_SIZE)
    no_index, no_value = np.zeros(0, np.intp), np.zeros(0)
    tracks = Tracks(no_index, no_index, np.zeros((0, 2)), no_value, no_index)
    state = AdjustmentState(cameras, np.zeros((0, 3)), np.zeros(CAMERA_PARAMETER_COUNT))
    problem = AdjustmentProblem.from_tracks(tracks, cameras.poses, np.ones(6), surfaces=surfaces)
    problem = problem.update_planes(views, state)
    residuals = np.where(problem.surface_planes.depths > 0, problem.compute_surface_residuals(state), np.nan)
    first = surfaces.pair_indices[surfaces.pair_of_point, 0]
    return first, residuals, residuals * problem.surface_planes.sigmas_m


def estimate_pose_scale(given: NDArray[np.float64], fitted: NDArray[np.float64]) -> float | None:
    """Estimate the factor from fitted to given camera positions (Umeyama 1991).

    The standard error accounts for drift: residuals of successive frames are correlated.

    Parameters
    ----------
    given, fitted : (m, 3) camera centres, metres, in capture order.

    Returns
    -------
    None if the factor does not clearly differ from 1, or is implausible.
    """
    there, here = given - given.mean(axis=0), fitted - fitted.mean(axis=0)
    spread = float((here**2).sum())
    if len(given) < _MIN_VIEW_COUNT or spread <= 0:
        return None
    left, sizes, right = np.linalg.svd(np.einsum("ni,nj->ij", there, here))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = float((sizes * signs).sum()) / spread
    off = there - scale * np.einsum("ij,nj->ni", left * signs @ right, here)
    square = float((off**2).sum())
    correlation = float((off[1:] * off[:-1]).sum()) / max(square, 1e-12)
    correlation = min(max(correlation, 0.0), 0.99)
    # The variance of a mean of correlated samples is larger by this factor.
    inflation = (1 + correlation) / (1 - correlation)
    error = np.sqrt(inflation * square / (3 * len(given)) / spread)
    deviation = abs(scale - 1)
    return scale if _MIN_SCALE_SIGMAS * error < deviation < _MAX_SCALE_DEVIATION else None
