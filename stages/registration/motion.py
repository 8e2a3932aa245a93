"""The motion between two views: what is recognised in both says where to start, surfaces where to end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.registration.codes import REGISTER_PAIR_NOT_ALIGNED
from scanloom.stages.registration.features import Recognised, recognise
from scanloom.stages.registration.odometry import align, align_from_afar, meeting, told
from scanloom.stages.registration.points import Matched, at_source, joined
from scanloom.stages.registration.view import View
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Pose

# Matched points from which a motion is believed without a surface that agrees.
_SURE_POINTS = 15
# Below this a surface is flat, or nearly a cylinder or sphere: it slides along itself.
_FIRM = 2e-3
# Least share of a view that must meet the other's surface: where the motion is nearly known; where it is not;
# where, besides, both views have so many points and none of them in common; and where sure points say so too.
_LEAST_FITNESS = 0.3
_LEAST_FROM_AFAR = 0.5
_LEAST_UNRECOGNISED, _RICH = 0.75, 100
_LEAST_BESIDE_POINTS = 0.1
# How much more of the surface must meet for another motion than that of the most points.
_FIRST = 1.05
# How much more for the motion that surfaces tell than for that which points tell.
_CLEARLY = 1.25
# Where less of the surface meets, what was recognised may have moved on its own: surfaces are asked alone.
_DOUBTFUL = 0.6
# How far two ways to find one motion may differ: in median depths and in radians.
_AGREED_SHIFT = 0.03
_AGREED_TURN = 0.03
# How far off a motion that is known roughly may be, by the same measures.
_NEAR_SHIFT = 0.1
_NEAR_TURN = 0.1


@dataclass(frozen=True, eq=False)
class Motion:
    """How a view is placed to another.

    Attributes
    ----------
    target_from_source : (4, 4) metres.
    information : (6, 6) inverse covariance of a turn and a shift in the axes of the source.
    fitness : share of the source's surface that meets the target's, 0 to 1.
    rmse_m : their distance along the normals, root mean square; None where points alone tell the motion.
    points : recognised points that agree with it; 0 where nothing was recognised.
    is_split : something else in view moved differently.
    held : recognised points that it was not found by; None where nothing was recognised.
    """

    target_from_source: Pose
    information: NDArray[np.float64]
    fitness: float
    rmse_m: float | None
    points: int
    is_split: bool = False
    held: Matched | None = None


@dataclass(frozen=True)
class NoMotion:
    """Reason why two views could not be placed to each other."""

    diagnostic: Diagnostic


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
    start = np.eye(4) if guess is None else guess
    if not seen:
        return by_surface(source, target, max_depth, start)
    found = by_points(source, target, seen, max_depth)
    if isinstance(found, Motion) and found.fitness >= _DOUBTFUL:
        return found
    other = by_surface(source, target, max_depth, start)
    if isinstance(other, NoMotion):
        return found
    if isinstance(found, NoMotion):
        return other
    if agree(inverted(found.target_from_source) @ other.target_from_source, source.depth_m):
        return found
    if other.fitness > _FIRST * found.fitness:
        return replace(other, is_split=True)
    return replace(found, is_split=found.is_split or other.fitness * _CLEARLY > found.fitness)


def refined(source: View, target: View, max_depth: float, given: Pose) -> Motion:
    """Make a motion that is known roughly better; it is kept where nothing better is found.

    Parameters
    ----------
    given : (4, 4) target_from_source.
    """
    meets = meeting(source, target, given)
    kept = _of(given, told(target, meets) + np.eye(6), meets, None)
    found = motion_between(source, target, max_depth, given)
    if isinstance(found, NoMotion):
        return kept
    sure = found.points >= _SURE_POINTS
    if is_near(inverted(given) @ found.target_from_source, source.depth_m):
        return found if sure or found.fitness > _FIRST * kept.fitness else kept
    return found if sure and found.fitness > _CLEARLY * kept.fitness else kept


def by_surface(
    source: View, target: View, max_depth: float, guess: Pose, *, near: bool = False
) -> Motion | NoMotion:
    """Find the motion between two views by their surfaces alone, from a first guess and from both sides.

    Parameters
    ----------
    near : the guess is a good one.
    """
    fit = align if near else align_from_afar
    rich = min(len(source.features.points), len(target.features.points)) >= _RICH
    least = _LEAST_FITNESS if near else _LEAST_UNRECOGNISED if rich else _LEAST_FROM_AFAR
    if min(source.firmness, target.firmness) < _FIRM:
        return NoMotion(
            REGISTER_PAIR_NOT_ALIGNED.warning(
                "the surface in view is flat or slides along itself, and nothing on it is recognised: "
                "nothing holds the motion"
            )
        )
    there = fit(source, target, guess, max_depth)
    meets = None if there is None else meeting(source, target, there[0])
    if there is None or meets is None or meets < least:
        return _apart(meets, is_recognised=near or not rich)
    back = fit(target, source, inverted(guess), max_depth)
    if back is None or not agree(back[0] @ there[0], source.depth_m):
        return NoMotion(REGISTER_PAIR_NOT_ALIGNED.warning("the surfaces fit in more than one way"))
    return _of(there[0], told(target, meets), meets, there[1])


def by_points(source: View, target: View, seen: Sequence[Recognised], max_depth: float) -> Motion | NoMotion:
    """Find the motion between two views from what was recognised in both; `seen` is not empty.

    Where points tell several motions, something in view moves on its own. The motion of what stands still is
    that after which most of the surface meets; a surface that moves on its own would draw an alignment along.
    """
    first = inverted(seen[0].target_from_source)
    others = [one for one in seen if not agree(first @ one.target_from_source, source.depth_m)]
    if not others:
        return _refined(source, target, seen[0], max_depth)
    seen = [seen[0], *others]
    meets = [meeting(source, target, one.target_from_source) for one in seen]
    best = max(range(len(seen)), key=lambda i: meets[i] * (_FIRST if i == 0 else 1))
    found = _refined(source, target, seen[best], max_depth, held=seen[best].points >= _SURE_POINTS)
    return found if isinstance(found, NoMotion) else replace(found, is_split=True)


def _refined(
    source: View, target: View, seen: Recognised, max_depth: float, *, held: bool = False
) -> Motion | NoMotion:
    """Return the motion that points and surfaces tell together, each as far as it can be trusted."""
    points = seen.target_from_source
    sure = seen.points >= _SURE_POINTS
    aligned = None if held else align(source, target, points, max_depth)
    if aligned is not None and min(source.firmness, target.firmness) >= _FIRM:
        pose, rmse = aligned
        meets = meeting(source, target, pose)
        same = agree(inverted(points) @ pose, source.depth_m)
        # Else the points may be on something that moves on its own, and the rest of the surface tell.
        if same or (sure and meets > _CLEARLY * meeting(source, target, points)):
            if meets < (_LEAST_BESIDE_POINTS if same and sure else _LEAST_FITNESS):
                return _apart(meets)
            information = told(target, meets)
            if same:
                pose, information = joined(points, seen.information, pose, information)
            return _of(pose, information, meets, rmse, seen if same else None)
    if not sure:
        return NoMotion(
            REGISTER_PAIR_NOT_ALIGNED.warning(
                "the {points} points that are recognised and the surface do not agree on the motion",
                points=seen.points,
            )
        )
    meets = meeting(source, target, points)
    if meets < _LEAST_BESIDE_POINTS:
        return _apart(meets)
    return _of(points, seen.information, meets, None, seen)


def _of(
    pose: Pose,
    information: NDArray[np.float64],
    fitness: float,
    rmse: float | None,
    seen: Recognised | None = None,
) -> Motion:
    """Return a motion of which something is known in the axes of the target."""
    information = at_source(information, pose)
    if seen is None:
        return Motion(pose, information, fitness, rmse, 0)
    return Motion(pose, information, fitness, rmse, seen.points, held=seen.held)


def _apart(meets: float | None, *, is_recognised: bool = True) -> NoMotion:
    message = "only {share:.0%} of the surface meets the other view's"
    if not is_recognised:
        message = f"nothing is recognised in both, and {message}"
    return NoMotion(REGISTER_PAIR_NOT_ALIGNED.warning(message, share=0.0 if meets is None else meets))


def agree(difference: Pose, depth: float) -> bool:
    """Say whether a motion is next to none, for views of this median depth."""
    return _is_within(difference, _AGREED_SHIFT * depth, _AGREED_TURN)


def is_near(difference: Pose, depth: float) -> bool:
    """Say whether a chain may have drifted by a motion, for views of this median depth."""
    return _is_within(difference, _NEAR_SHIFT * depth, _NEAR_TURN)


def _is_within(motion: Pose, shift: float, turn: float) -> bool:
    return bool(np.linalg.norm(motion[:3, 3]) <= shift and angle(motion) <= turn)


def angle(pose: Pose) -> float:
    """Return how far a pose turns, in radians."""
    # The trace hardly tells small turns: the roundings of a pose in a text file would be a tenth of a degree.
    return float(2 * np.arcsin(min(np.linalg.norm(pose[:3, :3] - np.eye(3)) / np.sqrt(8), 1)))
