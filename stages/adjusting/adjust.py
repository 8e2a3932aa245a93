"""Refinement of poses and of the colour camera by bundle adjustment."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.adjustment_result import Adjustment, TransferError
from scanloom.stages.adjusting.agreement_check import AgreementSample, find_usable_frames, measure_agreement
from scanloom.stages.adjusting.bundle_adjustment import BundleResult, run_bundle_adjustment
from scanloom.stages.adjusting.cameras import (
    CAMERA_PARAMETER_COUNT,
    POSE_PARAMETER_COUNT,
    Cameras,
    compute_pose_distance,
    create_camera,
)
from scanloom.stages.adjusting.codes import ADJUST_IMAGES_MISMATCH
from scanloom.stages.adjusting.color_camera_prior import SilhouettePrior, create_silhouette_prior
from scanloom.stages.adjusting.final_depth_correction import (
    correct_depth,
    describe_depth_correction,
    finish_depth_correction,
    may_fit_depth,
)
from scanloom.stages.adjusting.key_frames import select_key_frames
from scanloom.stages.adjusting.matching import match_views
from scanloom.stages.adjusting.problem import FreeParameters
from scanloom.stages.adjusting.resection import LocalisedFrame, localise_between_key_frames
from scanloom.stages.adjusting.silhouette_offset import (
    PhotoOffset,
    SilhouetteObservation,
    estimate_photo_offset,
    observe_silhouettes,
)
from scanloom.stages.adjusting.view import (
    BLACK,
    OVER_EXPOSED,
    AdjustmentView,
    get_color_camera,
    get_color_from_depth,
    get_exposure_problem,
    has_common_color_camera,
    read_view_or_reason,
)
from scanloom.stages.adjusting.view_pairs import compute_overlap_matrix, select_view_pairs
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_count
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, Scan, SkippedFrame

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import AdjustKeywords

RESULT_VERSION = 11

# Maximum relative rise of the median transfer error when silhouettes correct the colour camera.
_MAX_ERROR_RISE = 0.05
# Approximate number of silhouette points in the prior on the colour camera.
_PRIOR_POINT_COUNT = 1000
# Median transfer error in pixels below which colour, depth and poses agree, so that no bundle adjustment
# runs.
_AGREEMENT_PX = 0.5
# Minimum decrease of the median transfer error for an accepted result: relative, and in pixels.
_MIN_GAIN_RATIO, _MIN_GAIN_PX = 0.2, 0.3
# Maximum number of key frames in the bundle adjustment. Frames between key frames are localised afterwards.
_MAX_KEY_FRAMES = 200
# Minimum number of observations of a key frame; with fewer, the key frame keeps its given pose.
_MIN_OBSERVATIONS = 12
# Progress steps reserved for `run_bundle_adjustment`, which calls `tell` at most this often.
_BUNDLE_STEPS = 5
# Progress steps reserved for the agreement of a sample, for silhouettes, and for the agreement with a
# corrected camera.
_CHECK_STEPS = (10, 10, 5)
# Maximum median pose change in standard deviations. A larger change means poses of another scan or
# convention.
_MAX_POSE_SIGMAS = 8.0
# Rotation per metre of translation in the prior on given poses, radians: 0.6° go with 20 mm.
_ROTATION_PER_M = float(np.radians(30))


@dataclass(frozen=True, kw_only=True)
class AdjustParams:
    """Parameters of the adjustment of poses and colour camera."""

    enabled: bool | None = param(
        None,
        "Adjust poses and the colour camera. Default: if frames have colour and depth. A result that is not "
        "better is discarded.",
        # This option selects whether the stage runs; it does not change the result of the stage.
        invalidates=False,
    )
    camera: bool | None = param(
        None,
        "Fit one colour camera for the whole scan (focal length, centre, k1, position relative to the depth "
        "camera). Default: if clearly better than poses alone, or if silhouettes show that photos are offset "
        "from depth. true always fits it, false keeps the given camera.",
    )
    shutter: bool | None = param(
        None,
        "Estimate the rotation of cameras while image rows are read out (rolling shutter). Default: if "
        "clearly better. true always estimates it, false assumes that all rows are read at once.",
    )
    depth: bool | None = param(
        None,
        "Fit a smooth correction of depth over image position and range. Default: if overlapping frames "
        "agree clearly better. true always fits it, false keeps depth as given.",
    )
    pose_sigma: float = param(
        0.02,
        "Standard deviation of the given poses: translation, and rotation with 0.3° per 10 mm.",
        unit="m",
        low=0,
        low_open=True,
    )

    def __post_init__(self) -> None:
        check_parameters(self)


def adjust(
    scan: Scan | Sequence[Frame],
    params: AdjustParams | None = None,
    *,
    progress: Progress = ignore_progress,
    has_metric_poses: bool = True,
    **changes: Unpack[AdjustKeywords],
) -> Adjustment:
    """Refine camera poses and the colour camera by bundle adjustment.

    Silhouettes in depth maps and photos show the offset between both. If the offset is clear, the colour
    camera is corrected first. Then a few frame pairs are matched. If colour, depth and poses agree there, the
    poses stay. Otherwise keypoints of at least three frames are joined into tracks. Bundle adjustment fits
    poses, points and one colour camera to keypoint positions and measured depth, with a prior on the given
    poses. Rolling-shutter rotations are fitted, too, if they clearly reduce the error. Every fifth track is
    held out; results that do not improve the held-out tracks are discarded. A smooth correction of depth is
    fitted with the poses, and used if overlapping depth maps agree clearly better at held-out points. Equal
    input gives bit-identical results on any number of threads.

    Parameters
    ----------
    scan : frames with colour, depth and poses; other frames are returned unchanged.
    params : AdjustParams; single fields can be passed by name instead.
    progress : called with the number of finished steps and the total number of steps.
    has_metric_poses : the given poses are measured independently of depth, so that they can fix the scale of
        corrected depth.

    Returns
    -------
    Adjusted : all frames, with metrics. `Adjustment.reason` states the reason if the poses stay as given.

    References
    ----------
    Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment – a modern synthesis", 2000; Hedborg,
    Forssén, Felsberg and Ringaby, "Rolling shutter bundle adjustment", 2012; Levinson and Thrun, "Automatic
    online calibration of cameras and lasers", 2013; Teichman, Miller and Thrun, "Unsupervised intrinsic
    calibration of depth sensors via SLAM", 2013. Features and fundamental matrices are computed with
    OpenCV, sparse algebra with SciPy.
    """
    params = resolve(AdjustParams, params, changes)
    with collecting() as diagnostics:
        frames = tuple(scan.frames if isinstance(scan, Scan) else scan)
        found = _adjust_if_needed(frames, params, progress, has_metric_poses=has_metric_poses)
    return replace(found, diagnostics=tuple(diagnostics))


def _adjust_if_needed(
    frames: tuple[Frame, ...], params: AdjustParams, progress: Progress, *, has_metric_poses: bool
) -> Adjustment:
    """Adjust frames unless a sample shows that they already agree."""
    start = time.perf_counter()
    frame_indices = find_usable_frames(frames)
    if len(frame_indices) < 2:
        prepared = _PreparedFrames(frames, frames, (), None, start)
        reason = "fewer than two frames have colour, depth and a pose"
        return _create_rejected_result(prepared, reason, (), None)
    usable = len(frame_indices)
    matching = min(usable, _MAX_KEY_FRAMES) // 2
    steps = _ProgressCounter(progress, sum(_CHECK_STEPS) + usable + matching + _BUNDLE_STEPS)
    agreement = measure_agreement(frames, frame_indices, steps.scale(0, _CHECK_STEPS[0]))
    if agreement.failure_reason:
        if agreement.is_inconsistent:
            _report_mismatch(agreement.failure_reason)
        prepared = _PreparedFrames(frames, frames, (), None, start)
        return _create_rejected_result(prepared, agreement.failure_reason, agreement.skipped, None)
    before = TransferError.from_errors(agreement.errors)
    prepared, agreement = _correct_camera_by_silhouettes(
        frames, frame_indices, agreement, params, steps, start
    )
    if agreement.median_px < _AGREEMENT_PX:
        reason = f"colour, depth and poses agree to {agreement.median_px:.2f} px already"
        return _create_rejected_result(prepared, reason, agreement.skipped, before)
    return _adjust_frames(
        prepared, frame_indices, agreement, params, steps, has_metric_poses=has_metric_poses
    )


@dataclass(frozen=True, eq=False)
class _PreparedFrames:
    """State before the bundle adjustment.

    Attributes
    ----------
    given_frames : frames of the scan.
    frames : the same frames, with the corrected colour camera if silhouettes show a clear offset.
    silhouettes : silhouettes of some frames; empty if the colour camera must not change.
    offset : photo-to-depth offset with the given colour camera; None if it could not be measured.
    start : `time.perf_counter()` when the work began, seconds.
    """

    given_frames: tuple[Frame, ...]
    frames: tuple[Frame, ...]
    silhouettes: Sequence[SilhouetteObservation]
    offset: PhotoOffset | None
    start: float

    @property
    def has_corrected_camera(self) -> bool:
        """Return True if silhouettes have corrected the colour camera."""
        return self.frames is not self.given_frames

    def measure_offset(self, frame: Frame) -> PhotoOffset | None:
        """Measure the photo-to-depth offset with the colour camera of a frame."""
        return estimate_photo_offset(self.silhouettes, get_color_camera(frame), get_color_from_depth(frame))


def _correct_camera_by_silhouettes(
    frames: tuple[Frame, ...],
    frame_indices: Sequence[int],
    agreement: AgreementSample,
    params: AdjustParams,
    steps: _ProgressCounter,
    start: float,
) -> tuple[_PreparedFrames, AgreementSample]:
    """Correct the colour camera if silhouettes show a clear offset.

    The correction is discarded if it raises the transfer error of matched points.

    Returns
    -------
    State with the frames to adjust, and the agreement measured on these frames.
    """
    first = frames[frame_indices[0]]
    may_move = params.camera is not False and has_common_color_camera(
        [frames[place] for place in frame_indices]
    )
    first_step, last_step = _CHECK_STEPS[0], sum(_CHECK_STEPS[:2])
    tell = steps.scale(first_step, last_step)
    shown = observe_silhouettes(frames, frame_indices, tell) if may_move else []
    found = estimate_photo_offset(shown, get_color_camera(first), get_color_from_depth(first))
    as_given = _PreparedFrames(frames, frames, shown, found, start)
    if found is None or not found.is_clear:
        return as_given, agreement
    given = get_color_camera(first)
    right, down = found.principal_point_shift_px * given.width / shown[0].full_size[0]
    camera = replace(given, cx=given.cx + right, cy=given.cy + down)
    apart = np.array(get_color_from_depth(first))
    apart[:2, 3] += found.translation_m
    moved = list(frames)
    for place in frame_indices:
        moved[place] = replace(moved[place], color_camera=camera, color_from_depth=apart)
    again = measure_agreement(moved, frame_indices, steps.scale(last_step, sum(_CHECK_STEPS)))
    if again.failure_reason or again.median_px > (1 + _MAX_ERROR_RISE) * agreement.median_px:
        # Silhouettes that contradict matched points must not influence the fitted camera either.
        return replace(as_given, silhouettes=()), agreement
    return _PreparedFrames(frames, tuple(moved), shown, found, start), again


def _adjust_frames(
    prepared: _PreparedFrames,
    frame_indices: Sequence[int],
    agreement: AgreementSample,
    params: AdjustParams,
    steps: _ProgressCounter,
    *,
    has_metric_poses: bool,
) -> Adjustment:
    frames = prepared.frames
    poses = np.stack([_get_pose(frames[place]) for place in frame_indices])
    chosen = [frame_indices[n] for n in select_key_frames(poses, _MAX_KEY_FRAMES)]
    checked = sum(_CHECK_STEPS)
    steps.advance_to(checked)
    skipped: list[SkippedFrame] = []
    views: dict[int, AdjustmentView] = {}
    threads = get_worker_count()

    def read(place: int) -> AdjustmentView | SkippedFrame:
        return agreement.views.get(place) or read_view_or_reason(frames[place])

    for place, view in zip(
        chosen, map_ordered(read, chosen, threads=threads, max_pending=threads + 2), strict=True
    ):
        if isinstance(view, AdjustmentView):
            views[place] = view
        else:
            skipped.append(view)
        steps.advance(1)
    keys = list(views)
    key_views = list(views.values())
    if len(keys) < 2:
        reason = "fewer than two key frames can be used"
        return _create_rejected_result(prepared, reason, skipped, TransferError.from_errors(agreement.errors))
    start = Cameras.from_frames([frames[place] for place in keys], [view.lens for view in key_views])
    view_pairs = select_view_pairs(compute_overlap_matrix(key_views, start))
    read_count = checked + len(chosen)
    matches = match_views(key_views, view_pairs, steps.scale(read_count, read_count + len(chosen) // 2))
    prior = params.pose_sigma * np.array([1.0] * 3 + [_ROTATION_PER_M] * 3)
    camera = (
        params.camera if _has_common_camera([frames[place] for place in frame_indices], key_views) else False
    )
    bundle_result = run_bundle_adjustment(
        key_views,
        start,
        matches,
        prior,
        camera,
        params.shutter,
        may_fit_depth(frames, params.depth),
        lambda cameras: _constrain_camera_by_silhouettes(prepared, key_views[0], cameras),
        lambda: steps.advance(1),
    )
    if bundle_result is None:
        reason = "too few points are matched in three or more frames"
        return _create_rejected_result(prepared, reason, skipped, TransferError.from_errors(agreement.errors))
    before, after = (
        TransferError.from_errors(bundle_result.errors_before),
        TransferError.from_errors(bundle_result.errors_after),
    )
    better, reason = _decide_acceptance(before, after)
    if not better:
        steps.finish()
        return _create_rejected_result(prepared, reason, skipped, before, after)
    implausible_reason = _explain_implausible_poses(start, bundle_result.cameras, prior)
    if implausible_reason:
        steps.finish()
        _report_mismatch(implausible_reason)
        return _create_rejected_result(prepared, implausible_reason, skipped, before, after)
    corrected_views, cameras, correction = finish_depth_correction(
        bundle_result, frames[keys[0]], start if has_metric_poses else None
    )
    bundle_result = replace(bundle_result, cameras=cameras)
    if correction is not None:
        views = dict(zip(keys, corrected_views, strict=True))
        frames = tuple(correct_depth(frame, correction) for frame in frames)
    found_poses = {
        place: LocalisedFrame(pose, turn)
        for place, pose, turn, count in zip(
            keys, cameras.poses, cameras.readout_rotations, bundle_result.observation_counts, strict=True
        )
        if count >= _MIN_OBSERVATIONS
    }
    between = sorted(set(frame_indices) - set(chosen))
    free = FreeParameters(bundle_result.is_camera_adjusted, bundle_result.is_shutter_adjusted)
    for place, one in localise_between_key_frames(frames, between, views, start, cameras, prior, free):
        if isinstance(one, SkippedFrame):
            skipped.append(one)
        elif one is not None:
            found_poses[place] = one
        steps.advance(1)
    steps.finish()
    result = list(frames)
    for place in frame_indices:
        result[place] = _apply_adjustment(frames[place], found_poses.get(place), bundle_result, views, keys)
    moved = np.array(
        [compute_pose_distance(_get_pose(frames[place]), one.pose) for place, one in found_poses.items()]
    )
    turns = np.degrees([np.linalg.norm(one.readout_rotation) for one in found_poses.values()])
    has_camera = bundle_result.is_camera_adjusted or prepared.has_corrected_camera
    return Adjustment(
        frames=tuple(result),
        adjusted_indices=tuple(sorted(found_poses)),
        accepted=True,
        reason=f"{_name_adjusted_parts(prepared, bundle_result)} adjusted: {reason}"
        + describe_depth_correction(correction, bundle_result.depth_agreement)
        + _describe_skipped(skipped),
        is_camera_adjusted=has_camera,
        is_shutter_adjusted=bundle_result.is_shutter_adjusted,
        offset_before=prepared.offset,
        offset_after=prepared.measure_offset(result[keys[0]]) if has_camera else None,
        error_before=before,
        error_after=after,
        key_frame_count=len(keys),
        point_count=bundle_result.point_count,
        unadjusted_count=len(frames) - len(found_poses),
        skipped=tuple(skipped),
        camera_before=get_color_camera(prepared.given_frames[keys[0]]),
        camera_after=get_color_camera(result[keys[0]]),
        translation_mm=(1000 * float(np.median(moved[:, 0])), 1000 * float(moved[:, 0].max())),
        rotation_deg=(float(np.median(moved[:, 1])), float(moved[:, 1].max())),
        readout_rotation_deg=(float(np.median(turns)), float(turns.max())),
        depth_correction=correction,
        depth_agreement=bundle_result.depth_agreement,
        seconds=time.perf_counter() - prepared.start,
    )


def _constrain_camera_by_silhouettes(
    prepared: _PreparedFrames, view: AdjustmentView, cameras: Cameras
) -> tuple[Cameras, SilhouettePrior | None]:
    """Correct a fitted colour camera by silhouettes, and create its prior.

    Returns the cameras unchanged and no prior if the offset is unclear.
    """
    camera = create_camera(cameras.lenses[0], view.size, view.full_size)
    found = estimate_photo_offset(prepared.silhouettes, camera, cameras.color_from_depth[0])
    if found is None or not found.is_clear:
        return cameras, None
    step = np.zeros(CAMERA_PARAMETER_COUNT)
    step[1:3] = found.principal_point_shift_px * view.size[0] / view.full_size[0]
    step[4:6] = found.translation_m
    moved = cameras.apply_step(np.zeros((len(cameras.poses), POSE_PARAMETER_COUNT)), step)
    points = np.concatenate([one.points for one in prepared.silhouettes])
    return moved, create_silhouette_prior(points[:: max(len(points) // _PRIOR_POINT_COUNT, 1)], moved)


def _name_adjusted_parts(prepared: _PreparedFrames, bundle_result: BundleResult) -> str:
    names = ["poses"]
    if bundle_result.is_camera_adjusted or prepared.has_corrected_camera:
        names.append("colour camera")
    if bundle_result.is_shutter_adjusted:
        names.append("rolling shutter")
    if bundle_result.views[0].depth_correction is not None:
        names.append("depth")
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _explain_implausible_poses(given: Cameras, found: Cameras, prior: NDArray[np.float64]) -> str:
    """Return the reason why the given poses are implausible; empty if plausible."""
    moved = np.array([compute_pose_distance(a, b) for a, b in zip(given.poses, found.poses, strict=True)])
    metres, degrees = np.median(moved, axis=0)
    if metres < _MAX_POSE_SIGMAS * prior[0] and degrees < _MAX_POSE_SIGMAS * np.degrees(prior[3]):
        return ""
    return (
        f"poses would move by {1000 * metres:.0f} mm and {degrees:.1f}° (median), far more than "
        "adjust.pose_sigma allows; they belong to another scan or have another pose convention"
    )


def _has_common_camera(frames: Sequence[Frame], views: Sequence[AdjustmentView]) -> bool:
    """Check whether all images share one colour camera with an adjustable lens."""
    return all(view.size == views[0].size for view in views) and has_common_color_camera(frames)


def _get_pose(frame: Frame) -> NDArray[np.float64]:
    return np.asarray(frame.world_from_camera, np.float64)


def _decide_acceptance(before: TransferError | None, after: TransferError | None) -> tuple[bool, str]:
    """Decide whether the adjusted result is better, and give the reason."""
    if before is None or after is None:
        return False, "no held-out point has depth both before and after"
    gained = before.median - after.median
    summary = f"the median error of held-out points is {after.median:.2f} px, before {before.median:.2f} px"
    if gained > _MIN_GAIN_RATIO * before.median and gained > _MIN_GAIN_PX:
        return True, summary
    return False, f"{summary}; an improvement of {_MIN_GAIN_RATIO:.0%} and {_MIN_GAIN_PX} px is required"


def _apply_adjustment(
    frame: Frame,
    localised: LocalisedFrame | None,
    bundle_result: BundleResult,
    views: dict[int, AdjustmentView],
    keys: Sequence[int],
) -> Frame:
    """Return a frame with its adjusted pose, readout rotation and colour camera.

    `localised` is None for frames that keep their pose. The colour camera changes only if it was fitted.
    """
    if localised is not None:
        turn = localised.readout_rotation if bundle_result.is_shutter_adjusted else frame.shutter_turn
        frame = replace(frame, world_from_camera=localised.pose, shutter_turn=turn)
    if not bundle_result.is_camera_adjusted:
        return frame
    first = views[keys[0]]
    return replace(
        frame,
        color_camera=create_camera(bundle_result.cameras.lenses[0], first.size, first.full_size),
        color_from_depth=bundle_result.cameras.color_from_depth[0],
    )


def _create_rejected_result(
    prepared: _PreparedFrames,
    reason: str,
    skipped: Sequence[SkippedFrame],
    before: TransferError | None,
    after: TransferError | None = None,
) -> Adjustment:
    """Create the result for poses that stay as given."""
    with_color = [n for n, frame in enumerate(prepared.given_frames) if frame.color is not None]
    # Frames without depth or pose keep their camera, so a frame with a corrected camera is preferred.
    moved = [n for n in with_color if prepared.frames[n] is not prepared.given_frames[n]]
    which = next(iter(moved or with_color), None)
    was, now = (
        None if which is None else get_color_camera(frames[which])
        for frames in (prepared.given_frames, prepared.frames)
    )
    reason = f"left as given: {reason}{_describe_skipped(skipped)}"
    if prepared.has_corrected_camera and prepared.offset is not None:
        reason = (
            f"colour camera moved by {prepared.offset.description}, to match silhouettes in the "
            f"photos; poses {reason}"
        )
    return Adjustment(
        frames=prepared.frames,
        adjusted_indices=(),
        accepted=prepared.has_corrected_camera,
        reason=reason,
        is_camera_adjusted=prepared.has_corrected_camera,
        is_shutter_adjusted=False,
        offset_before=prepared.offset,
        offset_after=None
        if not prepared.has_corrected_camera or which is None
        else prepared.measure_offset(prepared.frames[which]),
        error_before=before,
        error_after=after,
        key_frame_count=0,
        point_count=0,
        unadjusted_count=0,
        skipped=tuple(skipped),
        camera_before=was,
        camera_after=now,
        translation_mm=(0.0, 0.0),
        rotation_deg=(0.0, 0.0),
        readout_rotation_deg=(0.0, 0.0),
        seconds=time.perf_counter() - prepared.start,
    )


def _report_mismatch(reason: str) -> None:
    emit(ADJUST_IMAGES_MISMATCH.warning("not adjusted: {why}", why=reason))


def _describe_skipped(skipped: Sequence[SkippedFrame]) -> str:
    """Format a clause about unusable frames; empty if all frames are usable."""
    said = ""
    for what in (BLACK, OVER_EXPOSED):
        count = sum(get_exposure_problem(one) == what for one in skipped)
        said += f"; {format_count(count, 'frame')} skipped: {what} colour image" if count else ""
    unread = sum(get_exposure_problem(one) is None for one in skipped)
    return said + (f"; {format_count(unread, 'frame')} skipped: unreadable" if unread else "")


class _ProgressCounter:
    """Progress counter with a known total."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def advance(self, count: int) -> None:
        self.advance_to(self._done + count)

    def advance_to(self, done: int) -> None:
        self._done = min(max(done, self._done), self._total)
        self._progress(self._done, self._total)

    def scale(self, first: int, last: int) -> Progress:
        """Return a callback that maps progress of a part to the steps from `first` to `last`."""
        return lambda done, total: self.advance_to(first + (last - first) * done // max(total, 1))

    def finish(self) -> None:
        self.advance_to(self._total)
