"""Relative motion of two views: matched points initialise, surfaces refine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.registration.codes import REGISTER_PAIR_NOT_ALIGNED
from scanloom.stages.registration.features import FeatureMotion, estimate_motions
from scanloom.stages.registration.matched_points import (
    MatchedPoints,
    combine_motions,
    transform_information_to_source,
)
from scanloom.stages.registration.surface_alignment import (
    align,
    align_from_afar,
    compute_overlap,
    compute_surface_information,
)
from scanloom.stages.registration.view import RegistrationView
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Pose

# Number of inlier matches from which a motion is accepted without agreement of surfaces.
_MIN_CERTAIN_POINTS = 15
# Minimum `RegistrationView.firmness`. Below, the surface is nearly a plane, cylinder or sphere, and slides
# along itself.
_MIN_FIRMNESS = 2e-3
# Minimum overlap (ratio of a view's surface that meets the other surface): with a good initial guess; with a
# poor one; with a poor one and no match although both views have `_RICH_FEATURE_COUNT` features; with enough
# inlier matches.
_MIN_FITNESS = 0.3
_MIN_FITNESS_FROM_AFAR = 0.5
_MIN_FITNESS_UNMATCHED, _RICH_FEATURE_COUNT = 0.75, 100
_MIN_FITNESS_WITH_POINTS = 0.1
# Minimum overlap of another motion, relative to the motion with most inliers.
_MIN_FITNESS_LEAD = 1.05
# Minimum overlap of a motion from surfaces, relative to the motion from matched points.
_MIN_SURFACE_LEAD = 1.25
# With less overlap, matches may be on an independently moving object, so surfaces are aligned separately.
_DOUBTFUL_FITNESS = 0.6
# Maximum difference between two estimates of one motion: translation in median depths, rotation in radians.
_NEGLIGIBLE_SHIFT_RATIO = 0.03
_NEGLIGIBLE_ROTATION_RAD = 0.03
# Maximum error of an approximately known motion, in the same units.
_DRIFT_SHIFT_RATIO = 0.1
_DRIFT_ROTATION_RAD = 0.1


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
    inlier_count : number of inlier matches; 0 if nothing was matched.
    has_moving_part : another part of the view moved differently.
    held_out : inlier matches held out from the estimation; None if nothing was matched.
    """

    target_from_source: Pose
    information: NDArray[np.float64]
    fitness: float
    rmse_m: float | None
    inlier_count: int
    has_moving_part: bool = False
    held_out: MatchedPoints | None = None


@dataclass(frozen=True)
class AlignmentFailure:
    """Reason why two views could not be aligned."""

    diagnostic: Diagnostic


def estimate_motion(
    source: RegistrationView, target: RegistrationView, max_depth: float, guess: Pose | None = None
) -> Motion | AlignmentFailure:
    """Estimate the motion between two views.

    Parameters
    ----------
    source, target : views to align.
    max_depth : farther depth is ignored, metres.
    guess : (4, 4) initial target_from_source if nothing is matched; by default the identity.
    """
    seen = estimate_motions(source.features, target.features)
    start = np.eye(4) if guess is None else guess
    if not seen:
        return align_surfaces(source, target, max_depth, start)
    found = align_by_points(source, target, seen, max_depth)
    if isinstance(found, Motion) and found.fitness >= _DOUBTFUL_FITNESS:
        return found
    other = align_surfaces(source, target, max_depth, start)
    if isinstance(other, AlignmentFailure):
        return found
    if isinstance(found, AlignmentFailure):
        return other
    if is_negligible(invert_pose(found.target_from_source) @ other.target_from_source, source.depth_m):
        return found
    if other.fitness > _MIN_FITNESS_LEAD * found.fitness:
        return replace(other, has_moving_part=True)
    return replace(
        found, has_moving_part=found.has_moving_part or other.fitness * _MIN_SURFACE_LEAD > found.fitness
    )


def refine_motion(
    source: RegistrationView, target: RegistrationView, max_depth: float, approximate: Pose
) -> Motion:
    """Refine an approximate motion; keep it if no better one is found.

    Parameters
    ----------
    approximate : (4, 4) target_from_source.
    """
    meets = compute_overlap(source, target, approximate)
    kept = _create_motion(approximate, compute_surface_information(target, meets) + np.eye(6), meets, None)
    found = estimate_motion(source, target, max_depth, approximate)
    if isinstance(found, AlignmentFailure):
        return kept
    sure = found.inlier_count >= _MIN_CERTAIN_POINTS
    if is_within_drift(invert_pose(approximate) @ found.target_from_source, source.depth_m):
        return found if sure or found.fitness > _MIN_FITNESS_LEAD * kept.fitness else kept
    return found if sure and found.fitness > _MIN_SURFACE_LEAD * kept.fitness else kept


def align_surfaces(
    source: RegistrationView,
    target: RegistrationView,
    max_depth: float,
    guess: Pose,
    *,
    is_good_guess: bool = False,
) -> Motion | AlignmentFailure:
    """Align two views by their surfaces alone.

    Alignments in both directions must agree.

    Parameters
    ----------
    guess : (4, 4) initial target_from_source.
    is_good_guess : the guess is good, so that no coarse alignment and less overlap are needed.
    """
    fit = align if is_good_guess else align_from_afar
    rich = min(len(source.features.points), len(target.features.points)) >= _RICH_FEATURE_COUNT
    least = _MIN_FITNESS if is_good_guess else _MIN_FITNESS_UNMATCHED if rich else _MIN_FITNESS_FROM_AFAR
    if min(source.firmness, target.firmness) < _MIN_FIRMNESS:
        return AlignmentFailure(
            REGISTER_PAIR_NOT_ALIGNED.warning(
                "the surface in view is flat or slides along itself, and no keypoints match, so that nothing "
                "constrains the motion"
            )
        )
    there = fit(source, target, guess, max_depth)
    meets = None if there is None else compute_overlap(source, target, there[0])
    if there is None or meets is None or meets < least:
        return _create_overlap_failure(meets, has_matches=is_good_guess or not rich)
    back = fit(target, source, invert_pose(guess), max_depth)
    if back is None or not is_negligible(back[0] @ there[0], source.depth_m):
        return AlignmentFailure(
            REGISTER_PAIR_NOT_ALIGNED.warning(
                "alignments in both directions disagree, because the surfaces fit in several ways"
            )
        )
    return _create_motion(there[0], compute_surface_information(target, meets), meets, there[1])


def align_by_points(
    source: RegistrationView,
    target: RegistrationView,
    feature_motions: Sequence[FeatureMotion],
    max_depth: float,
) -> Motion | AlignmentFailure:
    """Estimate the motion from matched points, and refine it by surfaces.

    If the matches agree on several motions, something in view moves independently. The motion with the
    largest surface overlap is taken for the camera's motion. With enough matches, surfaces do not refine it,
    because the surface that moves independently would bias the alignment.

    Parameters
    ----------
    feature_motions : motions from `estimate_motions`, not empty.
    """
    first = invert_pose(feature_motions[0].target_from_source)
    others = [
        one for one in feature_motions if not is_negligible(first @ one.target_from_source, source.depth_m)
    ]
    if not others:
        return _combine_with_surface(source, target, feature_motions[0], max_depth)
    feature_motions = [feature_motions[0], *others]
    meets = [compute_overlap(source, target, one.target_from_source) for one in feature_motions]
    best = max(range(len(feature_motions)), key=lambda i: meets[i] * (_MIN_FITNESS_LEAD if i == 0 else 1))
    found = _combine_with_surface(
        source,
        target,
        feature_motions[best],
        max_depth,
        points_only=feature_motions[best].inlier_count >= _MIN_CERTAIN_POINTS,
    )
    return found if isinstance(found, AlignmentFailure) else replace(found, has_moving_part=True)


def _combine_with_surface(
    source: RegistrationView,
    target: RegistrationView,
    feature_motion: FeatureMotion,
    max_depth: float,
    *,
    points_only: bool = False,
) -> Motion | AlignmentFailure:
    """Combine the motions from points and surfaces, weighted by their information.

    `held_out` uses the points alone.
    """
    points = feature_motion.target_from_source
    sure = feature_motion.inlier_count >= _MIN_CERTAIN_POINTS
    aligned = None if points_only else align(source, target, points, max_depth)
    if aligned is not None and min(source.firmness, target.firmness) >= _MIN_FIRMNESS:
        pose, rmse = aligned
        meets = compute_overlap(source, target, pose)
        same = is_negligible(invert_pose(points) @ pose, source.depth_m)
        # On disagreement, the points may be on an object that moves independently; larger overlap decides.
        if same or (sure and meets > _MIN_SURFACE_LEAD * compute_overlap(source, target, points)):
            if meets < (_MIN_FITNESS_WITH_POINTS if same and sure else _MIN_FITNESS):
                return _create_overlap_failure(meets)
            information = compute_surface_information(target, meets)
            if same:
                pose, information = combine_motions(points, feature_motion.information, pose, information)
            return _create_motion(pose, information, meets, rmse, feature_motion if same else None)
    if not sure:
        return AlignmentFailure(
            REGISTER_PAIR_NOT_ALIGNED.warning(
                "{points} matched keypoints and the surface disagree on the motion",
                points=feature_motion.inlier_count,
            )
        )
    meets = compute_overlap(source, target, points)
    if meets < _MIN_FITNESS_WITH_POINTS:
        return _create_overlap_failure(meets)
    return _create_motion(points, feature_motion.information, meets, None, feature_motion)


def _create_motion(
    pose: Pose,
    information: NDArray[np.float64],
    fitness: float,
    rmse: float | None,
    feature_motion: FeatureMotion | None = None,
) -> Motion:
    """Create a motion from an information matrix in target axes."""
    information = transform_information_to_source(information, pose)
    if feature_motion is None:
        return Motion(pose, information, fitness, rmse, 0)
    return Motion(
        pose, information, fitness, rmse, feature_motion.inlier_count, held_out=feature_motion.held_out
    )


def _create_overlap_failure(overlap: float | None, *, has_matches: bool = True) -> AlignmentFailure:
    message = "only {share:.0%} of the surface overlaps with the other view"
    if not has_matches:
        message = f"no keypoints match, and {message}"
    return AlignmentFailure(
        REGISTER_PAIR_NOT_ALIGNED.warning(message, share=0.0 if overlap is None else overlap)
    )


def is_negligible(difference: Pose, median_depth_m: float) -> bool:
    """Check whether a motion is negligible.

    Parameters
    ----------
    difference : (4, 4) motion, metres.
    median_depth_m : median depth of the views, metres.
    """
    return _is_within(difference, _NEGLIGIBLE_SHIFT_RATIO * median_depth_m, _NEGLIGIBLE_ROTATION_RAD)


def is_within_drift(difference: Pose, median_depth_m: float) -> bool:
    """Check whether a motion is within the drift of a chain.

    The parameters are as for `is_negligible`.
    """
    return _is_within(difference, _DRIFT_SHIFT_RATIO * median_depth_m, _DRIFT_ROTATION_RAD)


def _is_within(motion: Pose, max_shift_m: float, max_rotation_rad: float) -> bool:
    return bool(
        np.linalg.norm(motion[:3, 3]) <= max_shift_m and compute_rotation_angle(motion) <= max_rotation_rad
    )


def compute_rotation_angle(pose: Pose) -> float:
    """Compute the rotation angle of a pose, radians."""
    # The trace is inaccurate at small angles: poses rounded in text files would give a tenth of a degree.
    return float(2 * np.arcsin(min(np.linalg.norm(pose[:3, :3] - np.eye(3)) / np.sqrt(8), 1)))
