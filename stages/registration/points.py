"""The motion that matched points tell, each trusted as far as its pixel and its own depth can be.

A point lies in an ellipsoid: a pixel wide, and along its ray as long as depth is off there. The motion is
that of least distance between the points of both views, in deviations of both ellipsoids (Segal, Haehnel and
Thrun, "Generalized-ICP", 2009, for matches that are known).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Pose

# Pixels that a point is off; metres that depth is, and how this grows with its square: at first, at the least
# and at the most. A pair tells how much its own depth is off.
_PIXEL = 0.5
_DEPTH_M, _DEPTH_PER_M, _LEAST_PER_M, _MOST_PER_M = 0.001, 0.0016, 1e-4, 2e-2
# Points count for a quarter at so many deviations, and soon for nothing (Geman and McClure): outlines of
# round things and glints go with the camera, and there are always some.
_BEND = 2.0
_STEPS = 6
# Steps after which depth is measured anew, and the points that this needs.
_TOLD, _ENOUGH = (1, 3), 20
# The median length of three numbers that are each off by a deviation.
_MEDIAN_LENGTH = 1.54
_MAD = 1.4826
# Points may be known better than was thought, but not by more than this share.
_LEAST_MORE = 0.3
# Of so many points one is kept apart, to judge poses by.
_HELD_OUT = 8


@dataclass(frozen=True, eq=False)
class Matched:
    """The same n points in the axes of two cameras.

    Attributes
    ----------
    source, target : (n, 3) metres.
    focal : of the target's image in which they were found, pixels.
    """

    source: NDArray[np.float64]
    target: NDArray[np.float64]
    focal: float

    def __len__(self) -> int:
        return len(self.source)

    def take(self, which: NDArray[np.bool_]) -> Matched:
        """Return some of them."""
        return Matched(self.source[which], self.target[which], self.focal)

    def parted(self) -> tuple[Matched, Matched]:
        """Return those that poses are found by, and those that they are judged by."""
        held = np.arange(len(self)) % _HELD_OUT == _HELD_OUT - 1
        return self.take(~held), self.take(held)

    def transfer_errors(self, target_from_source: Pose) -> NDArray[np.float64]:
        """Return how far from its match each point lands in the target's image, (n,) pixels."""
        moved = self.source @ target_from_source[:3, :3].T + target_from_source[:3, 3]
        z = np.where(moved[:, 2] > 0, moved[:, 2], 1e-6)
        off = moved[:, :2] / z[:, None] - self.target[:, :2] / self.target[:, 2:]
        return np.asarray(self.focal * np.hypot(*off.T))


def fitted(matched: Matched, near: Pose) -> tuple[Pose, NDArray[np.float64]]:
    """Return the motion (target_from_source) of matched points, and how firmly they hold it.

    Parameters
    ----------
    near : (4, 4) a motion that brings most of them together.

    Returns
    -------
    pose : (4, 4) metres.
    information : (6, 6) inverse covariance of a turn and a shift after it, in the axes of the target.
    """
    source, target = matched.source, matched.target
    pose, per_m = near, _DEPTH_PER_M
    information = np.zeros((6, 6))
    for step in range(_STEPS):
        moved = source @ pose[:3, :3].T + pose[:3, 3]
        # Both measure one depth: a point is not nearer, and so trusted more, by its own error.
        deep = deviation(0.5 * (moved[:, 2] + target[:, 2]), per_m)
        own = pose[:3, :3] @ _ellipsoids(source, deep, matched.focal) @ pose[:3, :3].T
        sharp = np.linalg.inv(own + _ellipsoids(target, deep, matched.focal))
        apart = target - moved
        off = np.sqrt(np.einsum("ni,nij,nj->n", apart, sharp, apart))
        # Where pixels or depth are off by more than was thought, all is known less well.
        more = max(float(np.median(off)) / _MEDIAN_LENGTH, _LEAST_MORE)
        weight = 1 / (1 + (off / (_BEND * more)) ** 2) ** 2
        # Points move as they do where both views say they are: a turn that was told by where one view says so
        # would come out short by that view's own errors, for what is left between the two has the same.
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
    """Return the standard deviation of depth (n,), metres: it grows with its square."""
    return np.asarray(_DEPTH_M + per_m * depth**2)


def joined(
    one: Pose, information: NDArray[np.float64], other: Pose, more: NDArray[np.float64]
) -> tuple[Pose, NDArray[np.float64]]:
    """Return the motion that two that were found of one thing tell, each as far as it is known.

    Parameters
    ----------
    one, other : (4, 4) target_from_source, next to each other.
    information, more : (6, 6) of these, see `fitted`.
    """
    both = information + more
    step = np.linalg.lstsq(both, more @ step_of(other @ inverted(one)), rcond=1e-12)[0]
    return motion_of(np.asarray(step, np.float64)) @ one, both


def at_source(information: NDArray[np.float64], target_from_source: Pose) -> NDArray[np.float64]:
    """Return what is known of a motion in the axes of the source."""
    turn, shift = target_from_source[:3, :3], target_from_source[:3, 3]
    across = np.zeros((6, 6))
    across[:3, :3] = across[3:, 3:] = turn
    across[3:, :3] = np.cross(shift, turn.T).T
    return np.asarray(across.T @ information @ across)


def motion_of(step: NDArray[np.float64]) -> Pose:
    """Return the (4, 4) motion of a small (6,) turn (rotation vector) and shift."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
    return pose


def step_of(motion: Pose) -> NDArray[np.float64]:
    """Return the (6,) turn and shift of a motion."""
    from scipy.spatial.transform import Rotation

    return np.concatenate([Rotation.from_matrix(motion[:3, :3]).as_rotvec(), motion[:3, 3]])


def _by_motion(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how (n, 3) points move with a turn and a shift, (n, 3, 6)."""
    steps = np.zeros((len(points), 3, 6))
    steps[:, :, :3] = np.cross(np.eye(3)[None], points[:, None, :]).swapaxes(1, 2)
    steps[:, :, 3:] = np.eye(3)
    return steps


def _ellipsoids(points: NDArray[np.float64], deep: NDArray[np.float64], focal: float) -> NDArray[np.float64]:
    """Return the (n, 3, 3) covariance of points that a pixel and a depth tell; `deep` are deviations."""
    rays = points / points[:, 2:] * deep[:, None]
    spread = rays[:, :, None] * rays[:, None, :]
    wide = (_PIXEL / focal * points[:, 2]) ** 2
    spread[:, 0, 0] += wide
    spread[:, 1, 1] += wide
    return spread
