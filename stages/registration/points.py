"""Relative motion of matched points, weighted by the uncertainty of pixel and depth.

The uncertainty of a point is an ellipsoid: a pixel wide, and along its ray as long as the depth error. The
motion minimises the Mahalanobis distance of matched points (Segal, Haehnel and Thrun, "Generalized-ICP",
2009, with known matches).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Pose

# Standard deviation of a keypoint, pixels. Standard deviation of depth: a constant in metres, and a factor
# per squared metre with its minimum and maximum. The factor is estimated for each pair of views.
_PIXEL = 0.5
_DEPTH_M, _DEPTH_PER_M, _LEAST_PER_M, _MOST_PER_M = 0.001, 0.0016, 1e-4, 2e-2
# Scale of the Geman-McClure loss, in standard deviations, and number of iterations. There are always
# outliers: silhouettes of round objects and glints move with the camera.
_BEND = 2.0
_STEPS = 6
# Iterations after which the depth error is estimated again, and the minimum number of points for that.
_TOLD, _ENOUGH = (1, 3), 20
# Median length of a standard normal vector in 3-D; factor from the median absolute deviation to the standard
# deviation.
_MEDIAN_LENGTH = 1.54
_MAD = 1.4826
# Minimum scale of the residuals: points are not trusted more than this, however well they fit.
_LEAST_MORE = 0.3
# One of this many points is held out, to judge poses.
_HELD_OUT = 8


@dataclass(frozen=True, eq=False)
class Matched:
    """n matched points, in the camera axes of two views.

    Attributes
    ----------
    source, target : (n, 3) metres.
    focal : focal length of the target's image, pixels.
    """

    source: NDArray[np.float64]
    target: NDArray[np.float64]
    focal: float

    def __len__(self) -> int:
        return len(self.source)

    def take(self, which: NDArray[np.bool_]) -> Matched:
        """Select points by a mask."""
        return Matched(self.source[which], self.target[which], self.focal)

    def parted(self) -> tuple[Matched, Matched]:
        """Split the points into those for estimation and held-out ones."""
        held = np.arange(len(self)) % _HELD_OUT == _HELD_OUT - 1
        return self.take(~held), self.take(held)

    def transfer_errors(self, target_from_source: Pose) -> NDArray[np.float64]:
        """Compute the transfer errors (n,), pixels of the target's image.

        The transfer error is the distance between a reprojected source point and its match.
        """
        moved = self.source @ target_from_source[:3, :3].T + target_from_source[:3, 3]
        z = np.where(moved[:, 2] > 0, moved[:, 2], 1e-6)
        off = moved[:, :2] / z[:, None] - self.target[:, :2] / self.target[:, 2:]
        return np.asarray(self.focal * np.hypot(*off.T))


def fitted(matched: Matched, near: Pose) -> tuple[Pose, NDArray[np.float64]]:
    """Fit the motion of matched points.

    Parameters
    ----------
    near : (4, 4) approximate target_from_source.

    Returns
    -------
    pose : (4, 4) target_from_source, metres.
    information : (6, 6) inverse covariance of a rotation and a subsequent translation, target axes.
    """
    source, target = matched.source, matched.target
    pose, per_m = near, _DEPTH_PER_M
    information = np.zeros((6, 6))
    for step in range(_STEPS):
        moved = source @ pose[:3, :3].T + pose[:3, 3]
        # The depth is averaged over both views: an error that makes a point nearer must not raise its weight.
        deep = deviation(0.5 * (moved[:, 2] + target[:, 2]), per_m)
        own = pose[:3, :3] @ _ellipsoids(source, deep, matched.focal) @ pose[:3, :3].T
        sharp = np.linalg.inv(own + _ellipsoids(target, deep, matched.focal))
        apart = target - moved
        off = np.sqrt(np.einsum("ni,nij,nj->n", apart, sharp, apart))
        # Larger residuals than expected increase the assumed uncertainty of all points.
        more = max(float(np.median(off)) / _MEDIAN_LENGTH, _LEAST_MORE)
        weight = 1 / (1 + (off / (_BEND * more)) ** 2) ** 2
        # Derivatives are taken at the fused positions. Positions of one view contain the same errors as the
        # residuals, which would bias the rotation towards zero.
        steps = _by_motion(moved + np.einsum("nij,njk,nk->ni", own, sharp, apart))
        weighed = (weight[:, None, None] * (sharp @ steps)).reshape(-1, 6)
        information = steps.reshape(-1, 6).T @ weighed / more**2
        found = np.linalg.lstsq(information, weighed.T @ apart.reshape(-1) / more**2, rcond=1e-12)[0]
        pose = motion_of(found) @ pose
        if step in _TOLD and len(source) >= _ENOUGH:
            gap = np.abs(target[:, 2] - source @ pose[2, :3] - pose[2, 3]) / target[:, 2] ** 2
            per_m = float(np.clip(_MAD * np.median(gap) / np.sqrt(2), _LEAST_PER_M, _MOST_PER_M))
    return pose, information


def deviation(depth: NDArray[np.float64], per_m: float = _DEPTH_PER_M) -> NDArray[np.float64]:
    """Compute the standard deviation of depth (n,), metres.

    It grows with the square of the depth.
    """
    return np.asarray(_DEPTH_M + per_m * depth**2)


def joined(
    one: Pose, information: NDArray[np.float64], other: Pose, more: NDArray[np.float64]
) -> tuple[Pose, NDArray[np.float64]]:
    """Combine two estimates of one motion, weighted by their information.

    Parameters
    ----------
    one, other : (4, 4) target_from_source, close to each other.
    information, more : (6, 6) information matrices of these, see `fitted`.

    Returns
    -------
    Combined motion, and its information matrix.
    """
    both = information + more
    step = np.linalg.lstsq(both, more @ step_of(other @ inverted(one)), rcond=1e-12)[0]
    return motion_of(np.asarray(step, np.float64)) @ one, both


def at_source(information: NDArray[np.float64], target_from_source: Pose) -> NDArray[np.float64]:
    """Transform an information matrix (6, 6) from target axes to source axes."""
    turn, shift = target_from_source[:3, :3], target_from_source[:3, 3]
    across = np.zeros((6, 6))
    across[:3, :3] = across[3:, 3:] = turn
    across[3:, :3] = np.cross(shift, turn.T).T
    return np.asarray(across.T @ information @ across)


def motion_of(step: NDArray[np.float64]) -> Pose:
    """Compute the motion (4, 4) of a rotation vector and translation (6,)."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
    return pose


def step_of(motion: Pose) -> NDArray[np.float64]:
    """Decompose a motion (4, 4) into rotation vector and translation (6,)."""
    from scipy.spatial.transform import Rotation

    return np.concatenate([Rotation.from_matrix(motion[:3, :3]).as_rotvec(), motion[:3, 3]])


def _by_motion(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute derivatives (n, 3, 6) of points (n, 3) by rotation and translation."""
    steps = np.zeros((len(points), 3, 6))
    steps[:, :, :3] = np.cross(np.eye(3)[None], points[:, None, :]).swapaxes(1, 2)
    steps[:, :, 3:] = np.eye(3)
    return steps


def _ellipsoids(points: NDArray[np.float64], deep: NDArray[np.float64], focal: float) -> NDArray[np.float64]:
    """Compute the covariances (n, 3, 3) of points, from pixel and depth errors.

    Parameters
    ----------
    points : (n, 3) metres, camera axes.
    deep : (n,) standard deviations of depth, metres.
    focal : focal length, pixels.
    """
    rays = points / points[:, 2:] * deep[:, None]
    spread = rays[:, :, None] * rays[:, None, :]
    wide = (_PIXEL / focal * points[:, 2]) ** 2
    spread[:, 0, 0] += wide
    spread[:, 1, 1] += wide
    return spread
