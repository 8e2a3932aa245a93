"""The motion between two views: what is recognised in both says where to start, surfaces where to end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.formats.trajectories import inverted
from stages.registration.features import Recognised, recognise
from stages.registration.odometry import align, information
from stages.registration.view import View
from stages.scan import Pose

# Matched points from which a motion is believed without a surface that agrees.
SURE_POINTS = 30
# Below this a surface is flat, or nearly a cylinder or sphere: it slides along itself.
FIRM = 2e-3
# Least share of a view that must meet the other's surface; and where many points say so too.
LEAST_FITNESS = 0.3
_LEAST_BESIDE_POINTS = 0.1
# How far two ways to find one motion may differ: in median depths and in radians.
_AGREED_SHIFT = 0.03
_AGREED_TURN = 0.03


@dataclass(frozen=True, eq=False)
class Motion:
    """How a view is placed to another.

    Attributes
    ----------
    target_from_source : (4, 4) metres.
    information : (6, 6), for the pose graph.
    fitness : share of the source's pixels that meet the target's surface, 0 to 1.
    rmse_m : their distance along the normals, root mean square.
    points : recognised points that agree with it; 0 where nothing was recognised.
    is_split : what was recognised and the surfaces moved differently.
    """

    target_from_source: Pose
    information: NDArray[np.float64]
    fitness: float
    rmse_m: float
    points: int
    is_split: bool = False


@dataclass(frozen=True)
class NoMotion:
    """Why two views could not be placed to each other."""

    reason: str


def motion_between(
    source: View, target: View, max_depth: float, guess: Pose | None = None
) -> Motion | NoMotion:
    """Find the motion between two views.

    Parameters
    ----------
    guess : (4, 4) target_from_source to start from where nothing is recognised; none for nearly no motion,
        which is then found from both sides and has to be the same.
    """
    seen = recognise(source.features, target.features)
    if seen is not None:
        return by_points(source, target, seen, max_depth)
    return by_surface(source, target, max_depth, np.eye(4) if guess is None else guess)


def by_surface(source: View, target: View, max_depth: float, guess: Pose) -> Motion | NoMotion:
    """Find the motion between two views by their surfaces alone, from a first guess and from both sides."""
    if min(source.firmness, target.firmness) < FIRM:
        return NoMotion(
            "the surface in view is flat or slides along itself, and nothing on it is recognised: "
            "nothing holds the motion"
        )
    there = align(source, target, guess, max_depth)
    if there is None or there.fitness < LEAST_FITNESS:
        return NoMotion(
            f"only {0 if there is None else there.fitness:.0%} of the surface meets the other view's"
        )
    back = align(target, source, inverted(guess), max_depth)
    if back is None or not agree(back.target_from_source @ there.target_from_source, source.depth_m):
        return NoMotion("the surfaces fit in more than one way")
    return _motion(source, target, there.target_from_source, there.fitness, there.rmse_m, 0)


def by_points(source: View, target: View, seen: Recognised, max_depth: float) -> Motion | NoMotion:
    """Find the motion between two views from what was recognised in both."""
    aligned = align(source, target, seen.target_from_source, max_depth)
    firm = min(source.firmness, target.firmness) >= FIRM
    least = LEAST_FITNESS if seen.points < SURE_POINTS else _LEAST_BESIDE_POINTS
    if aligned is None or aligned.fitness < least:
        return NoMotion(
            f"only {0 if aligned is None else aligned.fitness:.0%} of the surface meets the other view's"
        )
    off = inverted(seen.target_from_source) @ aligned.target_from_source
    if firm and agree(off, source.depth_m):
        return _motion(
            source, target, aligned.target_from_source, aligned.fitness, aligned.rmse_m, seen.points
        )
    if seen.points >= SURE_POINTS:
        # Where the surface slides along itself, the points hold it.
        return _motion(
            source,
            target,
            seen.target_from_source,
            aligned.fitness,
            aligned.rmse_m,
            seen.points,
            is_split=firm,
        )
    return NoMotion(
        f"the {seen.points} points that are recognised and the surface do not agree on the motion"
    )


def _motion(
    source: View,
    target: View,
    pose: Pose,
    fitness: float,
    rmse: float,
    points: int,
    *,
    is_split: bool = False,
) -> Motion:
    return Motion(pose, information(source, target, pose), fitness, rmse, points, is_split)


def agree(difference: Pose, depth: float) -> bool:
    """Say whether a motion is next to none, for views of this median depth."""
    return bool(
        np.linalg.norm(difference[:3, 3]) <= _AGREED_SHIFT * depth and angle(difference) <= _AGREED_TURN
    )


def angle(pose: Pose) -> float:
    """Return how far a pose turns, in radians."""
    return float(np.arccos(np.clip((np.trace(pose[:3, :3]) - 1) / 2, -1, 1)))
