"""Relative motion of matched points, weighted by the uncertainty of pixel and depth.

The uncertainty of a point is an ellipsoid: a pixel wide, and along its ray as long as the depth error. The
motion minimises the Mahalanobis distance of matched points (Segal, Haehnel and Thrun, "Generalized-ICP",
2009, with known matches).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Pose

# Standard deviation of a keypoint, pixels. Standard deviation of depth: a constant in metres, and a factor
# per squared metre with its minimum and maximum. The factor is estimated for each pair of views.
_KEYPOINT_SIGMA_PX = 0.5
_DEPTH_SIGMA_M, _DEPTH_SIGMA_PER_M2, _MIN_SIGMA_PER_M2, _MAX_SIGMA_PER_M2 = 0.001, 0.0016, 1e-4, 2e-2
# Scale of the Geman-McClure loss, in standard deviations, and number of iterations. There are always
# outliers: silhouettes of round objects and glints move with the camera.
_LOSS_SCALE = 2.0
_STEP_COUNT = 6
# Iterations after which the depth error is estimated again, and the minimum number of points for that.
_REESTIMATION_STEPS, _MIN_POINTS = (1, 3), 20
# Median length of a standard normal vector in 3-D; factor from the median absolute deviation to the standard
# deviation.
_MEDIAN_LENGTH = 1.54
_MAD_TO_SIGMA = 1.4826
# Minimum scale of the residuals: points are not trusted more than this, however well they fit.
_MIN_RESIDUAL_SCALE = 0.3
# One of this many points is held out, to judge poses.
_HOLD_OUT_STRIDE = 8


@dataclass(frozen=True, eq=False)
class MatchedPoints:
    """n matched points, in the camera axes of two views.

    Attributes
    ----------
    source, target : (n, 3) metres.
    focal_px : focal length of the target's image, pixels.
    """

    source: NDArray[np.float64]
    target: NDArray[np.float64]
    focal_px: float

    def __len__(self) -> int:
        return len(self.source)

    def select(self, mask: NDArray[np.bool_]) -> MatchedPoints:
        """Select points by a mask."""
        return MatchedPoints(self.source[mask], self.target[mask], self.focal_px)

    def split_held_out(self) -> tuple[MatchedPoints, MatchedPoints]:
        """Split the points into those for estimation and held-out ones."""
        held = np.arange(len(self)) % _HOLD_OUT_STRIDE == _HOLD_OUT_STRIDE - 1
        return self.select(~held), self.select(held)

    def compute_transfer_errors(self, target_from_source: Pose) -> NDArray[np.float64]:
        """Compute the transfer errors (n,), pixels of the target's image.

        The transfer error is the distance between a reprojected source point and its match.
        """
        moved = self.source @ target_from_source[:3, :3].T + target_from_source[:3, 3]
        z = np.where(moved[:, 2] > 0, moved[:, 2], 1e-6)
        off = moved[:, :2] / z[:, None] - self.target[:, :2] / self.target[:, 2:]
        return np.asarray(self.focal_px * np.hypot(*off.T))


def fit_motion(matched: MatchedPoints, initial: Pose) -> tuple[Pose, NDArray[np.float64]]:
    """Fit the motion of matched points.

    Parameters
    ----------
    initial : (4, 4) approximate target_from_source.

    Returns
    -------
    pose : (4, 4) target_from_source, metres.
    information : (6, 6) inverse covariance of a rotation and a subsequent translation, target axes.
    """
    source, target = matched.source, matched.target
    pose, per_m = initial, _DEPTH_SIGMA_PER_M2
    information = np.zeros((6, 6))
    for step in range(_STEP_COUNT):
        moved = source @ pose[:3, :3].T + pose[:3, 3]
        # The depth is averaged over both views: an error that makes a point nearer must not raise its weight.
        deep = predict_depth_sigma(0.5 * (moved[:, 2] + target[:, 2]), per_m)
        own = pose[:3, :3] @ _compute_covariances(source, deep, matched.focal_px) @ pose[:3, :3].T
        sharp = np.linalg.inv(own + _compute_covariances(target, deep, matched.focal_px))
        apart = target - moved
        off = np.sqrt(np.einsum("ni,nij,nj->n", apart, sharp, apart))
        # Larger residuals than expected increase the assumed uncertainty of all points.
        more = max(float(np.median(off)) / _MEDIAN_LENGTH, _MIN_RESIDUAL_SCALE)
        weight = 1 / (1 + (off / (_LOSS_SCALE * more)) ** 2) ** 2
        # Derivatives are taken at the fused positions. Positions of one view contain the same errors as the
        # residuals, which would bias the rotation towards zero.
        steps = _compute_motion_derivatives(moved + np.einsum("nij,njk,nk->ni", own, sharp, apart))
        weighed = (weight[:, None, None] * (sharp @ steps)).reshape(-1, 6)
        information = steps.reshape(-1, 6).T @ weighed / more**2
        found = np.linalg.lstsq(information, weighed.T @ apart.reshape(-1) / more**2, rcond=1e-12)[0]
        pose = build_motion(found) @ pose
        if step in _REESTIMATION_STEPS and len(source) >= _MIN_POINTS:
            gap = np.abs(target[:, 2] - source @ pose[2, :3] - pose[2, 3]) / target[:, 2] ** 2
            per_m = float(
                np.clip(_MAD_TO_SIGMA * np.median(gap) / np.sqrt(2), _MIN_SIGMA_PER_M2, _MAX_SIGMA_PER_M2)
            )
    return pose, information


def predict_depth_sigma(
    depth: NDArray[np.float64], sigma_per_m2: float = _DEPTH_SIGMA_PER_M2
) -> NDArray[np.float64]:
    """Compute the standard deviation of depth (n,), metres.

    It grows with the square of the depth.
    """
    return np.asarray(_DEPTH_SIGMA_M + sigma_per_m2 * depth**2)


def combine_motions(
    first: Pose, first_information: NDArray[np.float64], second: Pose, second_information: NDArray[np.float64]
) -> tuple[Pose, NDArray[np.float64]]:
    """Combine two estimates of one motion, weighted by their information.

    Parameters
    ----------
    first, second : (4, 4) target_from_source, close to each other.
    first_information, second_information : (6, 6) information matrices of these, see `fit_motion`.

    Returns
    -------
    Combined motion, and its information matrix.
    """
    both = first_information + second_information
    step = np.linalg.lstsq(
        both, second_information @ decompose_motion(second @ invert_pose(first)), rcond=1e-12
    )[0]
    return build_motion(np.asarray(step, np.float64)) @ first, both


def transform_information_to_source(
    information: NDArray[np.float64], target_from_source: Pose
) -> NDArray[np.float64]:
    """Transform an information matrix (6, 6) from target axes to source axes."""
    turn, shift = target_from_source[:3, :3], target_from_source[:3, 3]
    across = np.zeros((6, 6))
    across[:3, :3] = across[3:, 3:] = turn
    across[3:, :3] = np.cross(shift, turn.T).T
    return np.asarray(across.T @ information @ across)


def build_motion(step: NDArray[np.float64]) -> Pose:
    """Compute the motion (4, 4) of a rotation vector and translation (6,)."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
    return pose


def decompose_motion(motion: Pose) -> NDArray[np.float64]:
    """Decompose a motion (4, 4) into rotation vector and translation (6,)."""
    from scipy.spatial.transform import Rotation

    return np.concatenate([Rotation.from_matrix(motion[:3, :3]).as_rotvec(), motion[:3, 3]])


def _compute_motion_derivatives(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute derivatives (n, 3, 6) of points (n, 3) by rotation and translation."""
    steps = np.zeros((len(points), 3, 6))
    steps[:, :, :3] = np.cross(np.eye(3)[None], points[:, None, :]).swapaxes(1, 2)
    steps[:, :, 3:] = np.eye(3)
    return steps


def _compute_covariances(
    points: NDArray[np.float64], depth_sigmas: NDArray[np.float64], focal_px: float
) -> NDArray[np.float64]:
    """Compute the covariances (n, 3, 3) of points, from pixel and depth errors.

    Parameters
    ----------
    points : (n, 3) metres, camera axes.
    depth_sigmas : (n,) standard deviations of depth, metres.
    focal_px : focal length, pixels.
    """
    rays = points / points[:, 2:] * depth_sigmas[:, None]
    spread = rays[:, :, None] * rays[:, None, :]
    wide = (_KEYPOINT_SIGMA_PX / focal_px * points[:, 2]) ** 2
    spread[:, 0, 0] += wide
    spread[:, 1, 1] += wide
    return spread
