"""Camera fits to matches: poses alone, with the colour camera, with rolling shutter.

Held-out tracks decide which model is used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import CAMERA_PARAMETER_COUNT, Cameras
from scanloom.stages.adjusting.color_camera_prior import SilhouettePrior
from scanloom.stages.adjusting.depth_calibration import (
    DepthAgreement,
    compute_depth_precision,
    create_neutral_correction,
    has_common_depth_camera,
    measure_depth_agreement,
)
from scanloom.stages.adjusting.matching import (
    MAX_GAP_RATIO,
    Matches,
    compute_match_errors,
    compute_point_gaps,
)
from scanloom.stages.adjusting.problem import AdjustmentProblem, AdjustmentState, FreeParameters
from scanloom.stages.adjusting.resection import fit_poses_separately
from scanloom.stages.adjusting.solver import solve
from scanloom.stages.adjusting.surface_points import SurfacePoints
from scanloom.stages.adjusting.tracks import Tracks, build_tracks
from scanloom.stages.adjusting.unprojection import transform_to_world, unproject_pixels
from scanloom.stages.adjusting.view import AdjustmentView, correct_views
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered

# One of this many tracks is held out.
_HOLD_OUT_STRIDE = 5
# Initial focal lengths of the colour camera, relative to the given one. Colour cameras of RGB-D sensors often
# have a wider field of view than the scan states.
_FOCAL_FACTORS = (1.0, 0.9)
# Approximate number of tracks in the fits that select a model; rounds of depth lookup, and solver steps in
# each round.
_MODEL_TRACK_COUNT, _LOOKUP_ROUNDS, _STEPS_PER_ROUND = 1500, 4, 3
# Rounds of the fit to all tracks. Few suffice, because the model fits have converged already.
_FINAL_ROUNDS = 2
# Rounds of the fit of the depth correction. Few suffice, because cameras are fitted already.
_DEPTH_ROUNDS = 3
# Maximum error ratio for accepting a fitted colour camera, at this percentile of the transfer error. The
# percentile is high because a wrong lens shows most at the image border.
_MAX_CAMERA_RATIO, _ERROR_PERCENTILE = 0.8, 90
# Maximum error ratio for accepting rolling-shutter rotations, at the same percentile. The fit is only tried
# if the cheaper fit of single views to fixed points reaches the second ratio.
_MAX_SHUTTER_RATIO, _MAX_TRIAL_RATIO = 0.8, 0.85
# Transfer error above which a match is an outlier, after a first fit of the cameras, pixels.
_OUTLIER_PX = 8.0


@dataclass(frozen=True, eq=False)
class BundleResult:
    """Result of the bundle adjustment.

    Attributes
    ----------
    cameras : adjusted cameras of all m views.
    is_camera_adjusted : the colour camera was adjusted.
    is_shutter_adjusted : rolling-shutter rotations were adjusted.
    errors_before, errors_after : (n,) transfer errors of the held-out matches that have an error in both
        cases, pixels.
    point_count : number of adjusted points.
    observation_counts : (m,) number of observations in each view.
    views : the views, with the depth correction if one is used.
    depth_agreement : agreement of depth maps on held-out points without and with a correction; None if no
        correction was fitted.
    """

    cameras: Cameras
    is_camera_adjusted: bool
    is_shutter_adjusted: bool
    errors_before: NDArray[np.float64]
    errors_after: NDArray[np.float64]
    point_count: int
    observation_counts: NDArray[np.intp]
    views: Sequence[AdjustmentView]
    depth_agreement: DepthAgreement | None


def run_bundle_adjustment(
    views: Sequence[AdjustmentView],
    given: Cameras,
    matches: Matches,
    pose_prior: NDArray[np.float64],
    camera: bool | None,
    shutter: bool | None,
    depth: bool | None,
    apply_silhouettes: Callable[[Cameras], tuple[Cameras, SilhouettePrior | None]],
    on_step: Callable[[], object],
) -> BundleResult | None:
    """Fit cameras to matches by bundle adjustment.

    Parameters
    ----------
    views : keypoints and depth of m views.
    given : initial cameras of the views.
    matches : matches that satisfy the epipolar geometry.
    pose_prior : (6,) standard deviations of the given poses, metres and radians.
    camera : fit the colour camera; None accepts it only if held-out points become clearly better.
    shutter : fit rolling-shutter rotations; None as for `camera`.
    depth : fit a smooth correction of depth; None as for `camera`.
    apply_silhouettes : corrects a fitted colour camera by silhouettes and returns it with a prior. If the
        offset is
        unclear, it returns the cameras unchanged and None.
    on_step : called after each of five parts of the work.

    Returns
    -------
    Bundle, or None if there are too few tracks.
    """
    near = compute_point_gaps(views, given, matches) < MAX_GAP_RATIO
    all_tracks = build_tracks(views, matches.select(near))
    if all_tracks.point_count < 2 * _HOLD_OUT_STRIDE:
        return None
    is_held_out = np.arange(all_tracks.point_count) % _HOLD_OUT_STRIDE == 0
    of_held = np.zeros(len(matches), bool)
    of_held[np.flatnonzero(near)] = np.where(
        all_tracks.point_of_match >= 0, is_held_out[all_tracks.point_of_match], False
    )
    held_out_matches = matches.select(of_held)

    surfaces = SurfacePoints.from_views(views, np.unique(matches.pair_indices, axis=0))
    measured = FitInput(views, given, surfaces, pose_prior)
    fitted = partial(fit_cameras, measured)

    def compute_errors(cameras: Cameras) -> NDArray[np.float64]:
        return compute_match_errors(views, cameras, held_out_matches)

    training_tracks = all_tracks.select(~is_held_out)
    model_tracks = _subsample_tracks(training_tracks)
    # The fits do not depend on each other.
    zooms = () if camera is False else _FOCAL_FACTORS
    starts = [(given.scale_focal_lengths(zoom), FreeParameters(camera=True)) for zoom in zooms]
    if not camera:
        starts.insert(0, (given, FreeParameters()))
    fits = map_ordered(
        lambda start: fitted(start[0], model_tracks, start[1]),
        starts,
        threads=get_worker_count(),
        max_pending=len(starts),
    )
    best, has_camera, has_turns = given, False, False
    if not camera:
        best = next(fits)
    on_step()
    for number, other in enumerate(fits):
        needed = 1.0 if has_camera else _MAX_CAMERA_RATIO
        if (camera and number == 0) or _compute_error_ratio(
            compute_errors(best), compute_errors(other)
        ) < needed:
            best, has_camera = other, True
        on_step()
    may_turn = (
        shutter is None
        and _compute_error_ratio(
            compute_errors(best), compute_errors(_fit_views_separately(measured, best, model_tracks))
        )
        < _MAX_TRIAL_RATIO
    )
    if shutter or may_turn:
        other = fitted(best, model_tracks, FreeParameters(has_camera, shutter=True))
        if shutter or _compute_error_ratio(compute_errors(best), compute_errors(other)) < _MAX_SHUTTER_RATIO:
            best, has_turns = other, True
    on_step()
    # Fitted cameras separate inliers from outliers better than epipolar geometry, so tracks are built again.
    training_matches = matches.select(~of_held)
    training_matches = training_matches.select(
        np.flatnonzero(compute_match_errors(views, best, training_matches) < _OUTLIER_PX)
    )
    training_tracks = build_tracks(views, _drop_held_out(training_matches, held_out_matches))
    if not training_tracks.point_count:
        return None
    best, silhouette_prior = apply_silhouettes(best) if has_camera else (best, None)
    free = FreeParameters(has_camera, has_turns)
    agreement = None
    if depth is not False:
        subset = _subsample_tracks(training_tracks)
        measured, best, agreement = _fit_depth(
            measured, best, subset, free, silhouette_prior, is_forced=depth is True
        )
    best = fit_cameras(measured, best, training_tracks, free, silhouette_prior, _FINAL_ROUNDS)
    on_step()
    before = compute_errors(given)
    after = compute_match_errors(measured.views, best, held_out_matches)
    both = ~(np.isnan(before) | np.isnan(after))
    return BundleResult(
        cameras=best,
        is_camera_adjusted=has_camera,
        is_shutter_adjusted=has_turns,
        errors_before=before[both],
        errors_after=after[both],
        point_count=training_tracks.point_count,
        observation_counts=np.bincount(training_tracks.view_indices, minlength=len(views)),
        views=measured.views,
        depth_agreement=agreement,
    )


def _subsample_tracks(tracks: Tracks) -> Tracks:
    """Return about `_MODEL_TRACK_COUNT` tracks, evenly spaced."""
    return tracks.select(
        np.arange(tracks.point_count) % max(tracks.point_count // _MODEL_TRACK_COUNT, 1) == 0
    )


def _drop_held_out(matches: Matches, held_out: Matches) -> Matches:
    """Drop matches that share a keypoint with a held-out match."""
    most = int(max(matches.keypoint_indices.max(initial=0), held_out.keypoint_indices.max(initial=0))) + 1
    held = np.unique(held_out.pair_indices * most + held_out.keypoint_indices)
    shared = np.asarray(np.isin(matches.pair_indices * most + matches.keypoint_indices, held).any(axis=1))
    return matches.select(~shared)


def _compute_error_ratio(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Compute the error ratio other / one, at the percentile `_ERROR_PERCENTILE`.

    Only matches with an error in both are compared; infinity without any.
    """
    both = ~(np.isnan(one) | np.isnan(other))
    if not both.any():
        return np.inf
    return float(np.percentile(other[both], _ERROR_PERCENTILE) / np.percentile(one[both], _ERROR_PERCENTILE))


class FitInput(NamedTuple):
    """Input that all fits share.

    Attributes
    ----------
    views : keypoints and depth of m views.
    given : cameras of the views as given, the centre of the pose prior.
    surfaces : surface points of frame pairs, for point-to-plane residuals.
    pose_prior : (6,) standard deviations of the given poses, metres and radians.
    """

    views: Sequence[AdjustmentView]
    given: Cameras
    surfaces: SurfacePoints
    pose_prior: NDArray[np.float64]


def fit_cameras(
    fit_input: FitInput,
    start: Cameras,
    training_tracks: Tracks,
    free: FreeParameters,
    silhouette_prior: SilhouettePrior | None = None,
    rounds: int = _LOOKUP_ROUNDS,
) -> Cameras:
    """Fit cameras by alternating depth lookup and solver steps.

    Returns `start` if no track has a measured depth.
    """
    prepared = _set_up_problem(fit_input, start, training_tracks, free, silhouette_prior)
    if prepared is None:
        return start
    problem, state = prepared
    for _ in range(rounds):
        problem = problem.update_planes(fit_input.views, state)
        state = solve(problem, state, _STEPS_PER_ROUND)
    return state.cameras


class _DepthFit(NamedTuple):
    """Fit of the depth correction.

    Attributes
    ----------
    fit_input : input with corrected views if the correction is used.
    cameras : cameras fitted with the correction, or without if it is not used.
    agreement : agreement of depth maps on held-out points; None if it could not be measured.
    """

    fit_input: FitInput
    cameras: Cameras
    agreement: DepthAgreement | None


def _fit_depth(
    fit_input: FitInput,
    start: Cameras,
    training_tracks: Tracks,
    free: FreeParameters,
    silhouette_prior: SilhouettePrior | None,
    *,
    is_forced: bool,
) -> _DepthFit:
    """Fit cameras and a smooth correction of depth.

    Parameters
    ----------
    start : cameras fitted without correction.
    is_forced : use the correction even if held-out points do not clearly agree better.
    """
    views, pairs = fit_input.views, fit_input.surfaces.pair_indices
    unused = _DepthFit(fit_input, start, None)
    neutral = create_neutral_correction(views) if has_common_depth_camera(views) and len(pairs) else None
    if neutral is None:
        return unused
    neutral_views = [replace(view, depth_correction=neutral) for view in views]
    surfaces = fit_input.surfaces.with_depth_basis(neutral_views)
    with_basis = fit_input._replace(views=neutral_views, surfaces=surfaces)
    prepared = _set_up_problem(
        with_basis, start, training_tracks, free._replace(depth=True), silhouette_prior
    )
    if prepared is None:
        return unused
    problem, state = prepared
    problem = replace(problem, depth_precision=compute_depth_precision(surfaces.basis))
    state = replace(state, depth_coefficients=np.zeros(surfaces.basis.shape[1]))
    for number in range(_DEPTH_ROUNDS):
        problem = problem.update_planes(neutral_views, state)
        state = solve(problem, state, _STEPS_PER_ROUND)
        corrected_views = correct_views(neutral_views, state.depth_coefficients)
        # Without correction, cameras have converged: more steps alone gain less than 1 %.
        agreement = measure_depth_agreement(pairs, (views, start), (corrected_views, state.cameras))
        is_last = number == _DEPTH_ROUNDS - 1
        is_better = agreement is not None and (agreement.is_clear if is_last else agreement.is_promising)
        if not (is_better or is_forced):
            return unused._replace(agreement=agreement)
    corrected = fit_input._replace(
        views=corrected_views, surfaces=SurfacePoints.from_views(corrected_views, pairs)
    )
    return _DepthFit(corrected, state.cameras, agreement)


def _fit_views_separately(fit_input: FitInput, start: Cameras, training_tracks: Tracks) -> Cameras:
    """Fit pose and readout rotation of each view alone, to fixed points."""
    prepared = _set_up_problem(
        fit_input._replace(surfaces=SurfacePoints.create_empty()),
        start,
        training_tracks,
        FreeParameters(shutter=True),
    )
    return (
        start
        if prepared is None
        else fit_poses_separately(fit_input.views, *prepared, _STEPS_PER_ROUND)[1].cameras
    )


def _set_up_problem(
    fit_input: FitInput,
    start: Cameras,
    training_tracks: Tracks,
    free: FreeParameters,
    silhouette_prior: SilhouettePrior | None = None,
) -> tuple[AdjustmentProblem, AdjustmentState] | None:
    """Set up the problem, with points at the mean of their measurements.

    Returns None if no track has a measured depth.
    """
    views, given, surfaces, pose_prior = fit_input
    places = transform_to_world(
        start,
        training_tracks.view_indices,
        unproject_pixels(views, start, training_tracks.view_indices, training_tracks.pixels),
        training_tracks.readout_times,
    )
    known = ~np.isnan(places[:, 0])
    counts = np.bincount(training_tracks.point_indices[known], minlength=training_tracks.point_count)
    if not counts.any():
        return None
    sums = [
        np.bincount(
            training_tracks.point_indices[known], places[known, axis], minlength=training_tracks.point_count
        )
        for axis in range(3)
    ]
    means = np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None]
    training_tracks = training_tracks.select(counts > 0)
    problem = AdjustmentProblem.from_tracks(
        training_tracks,
        given.poses,
        pose_prior,
        surfaces=surfaces,
        free=free,
        width=views[0].size[0],
        silhouette_prior=silhouette_prior,
    )
    return problem, AdjustmentState(start, means[counts > 0], np.zeros(CAMERA_PARAMETER_COUNT))
