"""Relative motion of two views: matched points initialise, surfaces refine."""

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

# Number of inlier matches from which a motion is accepted without agreement of surfaces.
_SURE_POINTS = 15
# Minimum `View.firmness`. Below, the surface is nearly a plane, cylinder or sphere, and slides along itself.
_FIRM = 2e-3
# Minimum overlap (ratio of a view's surface that meets the other surface): with a good initial guess; with a
# poor one; with a poor one and no match although both views have `_RICH` features; with enough inlier
# matches.
_LEAST_FITNESS = 0.3
_LEAST_FROM_AFAR = 0.5
_LEAST_UNRECOGNISED, _RICH = 0.75, 100
_LEAST_BESIDE_POINTS = 0.1
# Minimum overlap of another motion, relative to the motion with most inliers.
_FIRST = 1.05
# Minimum overlap of a motion from surfaces, relative to the motion from matched points.
_CLEARLY = 1.25
# With less overlap, matches may be on an independently moving object, so surfaces are aligned separately.
_DOUBTFUL = 0.6
# Maximum difference between two estimates of one motion: translation in median depths, rotation in radians.
_AGREED_SHIFT = 0.03
_AGREED_TURN = 0.03
# Maximum error of an approximately known motion, in the same units.
_NEAR_SHIFT = 0.1
_NEAR_TURN = 0.1


@dataclass(frozen=True, eq=False)
class Motion:
    """Relative pose of two views, with its quality.

    Attributes
    ----------
    target_from_source : (4, 4) metres.
    information : (6, 6) inverse covariance of rotation and translation, source axes.
    fitness : overlap: ratio of the source's surface that meets the target's surface, 0 to 1.
    rmse_m : point-to-plane distance of the overlap, root mean square, metres; None if the motion comes from
        matched points alone.
    points : number of inlier matches; 0 if nothing was matched.
    is_split : another part of the view moved differently.
    held : inlier matches held out from the estimation; None if nothing was matched.
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
    """Reason why two views could not be aligned."""

    diagnostic: Diagnostic


def motion_between(
    source: View, target: View, max_depth: float, guess: Pose | None = None
) -> Motion | NoMotion:
    """Estimate the motion between two views.

    Parameters
    ----------
    source, target : views to align.
    max_depth : farther depth is ignored, metres.
    guess : (4, 4) initial target_from_source if nothing is matched; by default the identity.
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
    """Refine an approximate motion; keep it if no better one is found.

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
    """Align two views by their surfaces alone.

    Alignments in both directions must agree.

    Parameters
    ----------
    guess : (4, 4) initial target_from_source.
    near : the guess is good, so that no coarse alignment and less overlap are needed.
    """
    fit = align if near else align_from_afar
    rich = min(len(source.features.points), len(target.features.points)) >= _RICH
    least = _LEAST_FITNESS if near else _LEAST_UNRECOGNISED if rich else _LEAST_FROM_AFAR
    if min(source.firmness, target.firmness) < _FIRM:
        return NoMotion(
            REGISTER_PAIR_NOT_ALIGNED.warning(
                "the surface in view is flat or slides along itself, and no keypoints match, so that nothing "
                "constrains the motion"
            )
        )
    there = fit(source, target, guess, max_depth)
    meets = None if there is None else meeting(source, target, there[0])
    if there is None or meets is None or meets < least:
        return _apart(meets, is_recognised=near or not rich)
    back = fit(target, source, inverted(guess), max_depth)
    if back is None or not agree(back[0] @ there[0], source.depth_m):
        return NoMotion(
            REGISTER_PAIR_NOT_ALIGNED.warning(
                "alignments in both directions disagree, because the surfaces fit in several ways"
            )
        )
    return _of(there[0], told(target, meets), meets, there[1])


def by_points(source: View, target: View, seen: Sequence[Recognised], max_depth: float) -> Motion | NoMotion:
    """Estimate the motion from matched points, and refine it by surfaces.

    If the matches agree on several motions, something in view moves independently. The motion with the
    largest surface overlap is taken for the camera's motion. With enough matches, surfaces do not refine it,
    because the surface that moves independently would bias the alignment.

    Parameters
    ----------
    seen : motions from `recognise`, not empty.
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
    """Combine the motions from points and surfaces, weighted by their information.

    `held` uses the points alone.
    """
    points = seen.target_from_source
    sure = seen.points >= _SURE_POINTS
    aligned = None if held else align(source, target, points, max_depth)
    if aligned is not None and min(source.firmness, target.firmness) >= _FIRM:
        pose, rmse = aligned
        meets = meeting(source, target, pose)
        same = agree(inverted(points) @ pose, source.depth_m)
        # On disagreement, the points may be on an object that moves independently; larger overlap decides.
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
                "{points} matched keypoints and the surface disagree on the motion",
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
    """Create a motion from an information matrix in target axes."""
    information = at_source(information, pose)
    if seen is None:
        return Motion(pose, information, fitness, rmse, 0)
    return Motion(pose, information, fitness, rmse, seen.points, held=seen.held)


def _apart(meets: float | None, *, is_recognised: bool = True) -> NoMotion:
    message = "only {share:.0%} of the surface overlaps with the other view"
    if not is_recognised:
        message = f"no keypoints match, and {message}"
    return NoMotion(REGISTER_PAIR_NOT_ALIGNED.warning(message, share=0.0 if meets is None else meets))


def agree(difference: Pose, depth: float) -> bool:
    """Check whether a motion is negligible.

    Parameters
    ----------
    difference : (4, 4) motion, metres.
    depth : median depth of the views, metres.
    """
    return _is_within(difference, _AGREED_SHIFT * depth, _AGREED_TURN)


def is_near(difference: Pose, depth: float) -> bool:
    """Check whether a motion is within the drift of a chain.

    The parameters are as for `agree`.
    """
    return _is_within(difference, _NEAR_SHIFT * depth, _NEAR_TURN)


def _is_within(motion: Pose, shift: float, turn: float) -> bool:
    return bool(np.linalg.norm(motion[:3, 3]) <= shift and angle(motion) <= turn)


def angle(pose: Pose) -> float:
    """Compute the rotation angle of a pose, radians."""
    # The trace is inaccurate at small angles: poses rounded in text files would give a tenth of a degree.
    return float(2 * np.arcsin(min(np.linalg.norm(pose[:3, :3] - np.eye(3)) / np.sqrt(8), 1)))
