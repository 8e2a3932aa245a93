"""Inspection of a scan before processing.

Everything is measured on a few sampled frames, so that inspection takes a second or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from scanloom.stages.adjusting.agreement_check import find_usable_frames, measure_agreement
from scanloom.stages.adjusting.silhouette_offset import estimate_photo_offset, observe_silhouettes
from scanloom.stages.adjusting.view import get_color_camera, get_color_from_depth, has_common_color_camera
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.fusion.depth_upsampling import upsample_single_frame
from scanloom.stages.fusion.fusion_plan import FusionPlan, make_plan
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.inspecting import consistency_checks
from scanloom.stages.inspecting.bent_depth import warn_bent_depth
from scanloom.stages.inspecting.camera_path import measure_camera_path
from scanloom.stages.inspecting.codes import CAMERA_COLOR_UNREGISTERED, SCAN_FRAMES_BLURRED
from scanloom.stages.inspecting.depth_range import KNOWN_DEPTH_SCALES, measure_depth_range, report_markers
from scanloom.stages.inspecting.epipolar_check import check_view_poses
from scanloom.stages.inspecting.image_sizes import report_sizes
from scanloom.stages.inspecting.inspection import Inspection
from scanloom.stages.inspecting.resource_estimate import estimate_fusion
from scanloom.stages.inspecting.unused_files import find_unused_files
from scanloom.stages.registration.focal_length import (
    estimate_focal_length,
    has_guessed_camera,
    report_focal_length,
)
from scanloom.stages.registration.focal_length_from_marks import estimate_focal_length_from_marks
from scanloom.stages.registration.moving_object import has_moving_object
from scanloom.stages.scans.codes import POSE_INCONSISTENT_WITH_IMAGES, SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.model.images import read_color, read_depth, read_right
from scanloom.stages.scans.model.prefetch import get_worker_count, run_concurrently
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Scan, StereoRig
from scanloom.stages.scans.model.sharpness import find_least_sharp
from scanloom.stages.scans.transforms.up_direction import find_up_direction

_SAMPLE_COUNT = 8
# Sharpness relative to the median frame, below which a frame is reported as blurred.
_MIN_SHARPNESS_RATIO = 0.25
# Pixels. Above this median misalignment between frames, colour detail is lost.
_MAX_MISFIT_PX = 1.5


def inspect(scan: Scan) -> Inspection:
    """Inspect a scan on a sample of its frames.

    Parameters
    ----------
    scan : scan with at least one frame; poses and calibration may be missing (see `Scan.missing`). Images are
        only read.

    Returns
    -------
    Inspection

    Raises
    ------
    InputError
        If no sampled frame can be read.
    """
    with collecting() as diagnostics:
        inspection = _inspect(scan)
    return replace(inspection, diagnostics=(*scan.diagnostics, *diagnostics))


def _inspect(scan: Scan) -> Inspection:
    samples = _read_samples(scan)
    path, up = measure_camera_path(scan), find_up_direction(scan)
    report_sizes(scan)
    depth, stereo_depth = None, None
    errors: dict[str, float] = {}
    misfit, suspicion, plan = None, None, None
    if scan.rig is not None and scan.rig.left.is_calibrated:
        stereo_depth = _compute_stereo_depth(scan.rig)
        consistency_checks.report_stereo_faults([(one.color, one.right) for one in samples], scan.rig)
    elif scan.is_views:
        suspicion = None if path is None else check_view_poses(scan.frames)[1]
        if suspicion is not None:
            emit(suspicion)
    elif scan.rig is None:
        scale_suspicion = (
            None
            if path is None or not scan.is_metric
            else consistency_checks.check_scale(scan.frames, KNOWN_DEPTH_SCALES)
        )
        depth = measure_depth_range([one.depth for one in samples], scan, with_hints=scale_suspicion is None)
        report_markers([one.frame for one in samples])
        errors, suspicion = ({}, None) if path is None else consistency_checks.check_poses(scan.frames)
        # A wrong depth unit also makes the poses look wrong, so the unit is reported first.
        suspicion = scale_suspicion or suspicion
        if suspicion is not None:
            emit(suspicion)
        is_suspicious = suspicion is not None
        has_plan = depth is not None and path is not None
        # OpenCV works on photos without the GIL, while NumPy compares depth maps.
        misfit, plan = run_concurrently(
            lambda: _check_photos(scan.frames),
            lambda: _check_depth_maps(scan, is_suspicious=is_suspicious) if has_plan else None,
        )
        if path is not None and misfit is None and not is_suspicious:
            consistency_checks.warn_inexact_poses(scan.frames)
    sharpness = _find_blurriest_frames(scan)
    subject = None
    if depth is not None and path is None and len(scan.frames) > 1:
        subject = "object" if has_moving_object(scan.frames) else "scene"
    focal = None
    if depth is not None and len(scan.frames) > 1 and has_guessed_camera(scan.frames):
        focal = estimate_focal_length(scan.frames)
        if focal is None and subject == "object":
            focal = estimate_focal_length_from_marks(scan.frames)
        report_focal_length(focal, scan.frames[0].camera)
    return Inspection(
        scan=scan,
        color_size=_find_color_size(samples),
        trajectory=path,
        depth=depth,
        stereo_depth_m=stereo_depth,
        reprojection_error_px=misfit,
        pose_errors_m=errors,
        blurriest_frames=sharpness,
        scene=None if plan is None else plan.scene,
        fusion_estimate=None if plan is None else estimate_fusion(scan.frames, plan),
        up=up,
        subject=subject,
        focal=focal,
        unused_files=find_unused_files(scan),
    )


@dataclass(frozen=True, eq=False)
class _SampledFrame:
    frame: Frame
    color: ColorImage | None
    right: ColorImage | None
    depth: DepthImage | None


def _read_samples(scan: Scan) -> list[_SampledFrame]:
    """Read frames evenly sampled over the scan; warn about unreadable ones."""
    chosen = sample_evenly(len(scan.frames), _SAMPLE_COUNT)
    found = [_read_sample(scan.frames[i]) for i in chosen]
    samples = [one for one in found if isinstance(one, _SampledFrame)]
    faults = [one for one in found if isinstance(one, InputError)]
    if not samples:
        raise faults[0]
    for error in faults:
        emit(SCAN_FRAMES_SKIPPED.warning("a sampled frame cannot be used: {reason}", reason=str(error)))
    return samples


def _read_sample(frame: Frame) -> _SampledFrame | InputError:
    try:
        return _SampledFrame(frame, read_color(frame), read_right(frame), read_depth(frame))
    except InputError as error:
        return error


def _check_photos(frames: Sequence[Frame]) -> float | None:
    """Check photos against depth and poses; return the median reprojection error, pixels."""
    _report_unregistered(frames)
    return _measure_misfit(frames)


def _check_depth_maps(scan: Scan, *, is_suspicious: bool) -> FusionPlan | None:
    """Plan the fusion, and compare overlapping depth maps unless poses are suspicious."""
    plan = _make_fusion_plan(scan)
    if plan is not None and not is_suspicious:
        warn_bent_depth(scan.frames, plan.noise)
    return plan


def _measure_misfit(frames: Sequence[Frame]) -> float | None:
    """Measure the median reprojection error between frames, pixels.

    Emits a warning if it is large. Returns None if it cannot be measured.
    """
    places = find_usable_frames(frames)
    seen = measure_agreement(frames, places) if len(places) > 1 else None
    if seen is None or seen.failure_reason:
        return None
    if seen.median_px >= _MAX_MISFIT_PX:
        emit(
            POSE_INCONSISTENT_WITH_IMAGES.warning(
                "colour, depth and poses are misaligned by {off:.1f} px (median of {count:,} points seen in "
                "two frames): `scanloom run` corrects them, `scanloom adjust` does only that",
                off=seen.median_px,
                count=len(seen.errors),
            )
        )
    return seen.median_px


def _report_unregistered(frames: Sequence[Frame]) -> None:
    """Warn if photos are offset from depth maps, judged by silhouettes."""
    frame_indices = [
        n for n, frame in enumerate(frames) if frame.color is not None and frame.depth is not None
    ]
    if not frame_indices or not has_common_color_camera([frames[n] for n in frame_indices]):
        return
    first = frames[frame_indices[0]]
    found = estimate_photo_offset(
        observe_silhouettes(frames, frame_indices), get_color_camera(first), get_color_from_depth(first)
    )
    if found is not None and found.is_clear:
        emit(
            CAMERA_COLOR_UNREGISTERED.warning(
                "colour is not registered to depth: judged by silhouettes, the photos are shifted {shift}",
                remedy=(
                    "if frames have poses, `scanloom run` corrects the colour camera, `scanloom adjust` does "
                    "only that"
                ),
                shift=found.description,
            )
        )


def _find_blurriest_frames(scan: Scan) -> tuple[tuple[str, float], ...]:
    worst, measured = find_least_sharp(scan.frames)
    named = tuple((frame.name, value) for frame, value in worst)
    blurred = [name for name, value in named if value < _MIN_SHARPNESS_RATIO]
    if blurred:
        emit(
            SCAN_FRAMES_BLURRED.warning(
                "{count} of {measured} sampled frames are blurred or show hardly any detail: {names}",
                names=", ".join(blurred[:3]) + (" …" if len(blurred) > 3 else ""),
                count=len(blurred),
                measured=measured,
            )
        )
    return named


def _make_fusion_plan(scan: Scan) -> FusionPlan | None:
    params = FuseParams()
    try:
        # Fusion emits the warnings of its plan itself.
        with collecting(forward=False):
            return make_plan(
                upsample_single_frame(scan.frames, params), params, scan.folder, get_worker_count()
            )
    except InputError:
        return None


def _find_color_size(samples: Sequence[_SampledFrame]) -> tuple[int, int] | None:
    color = next((one.color for one in samples if one.color is not None), None)
    return None if color is None else (color.shape[1], color.shape[0])


def _compute_stereo_depth(rig: StereoRig) -> tuple[float | None, float]:
    """Compute the depth at the largest disparity (None if unknown) and at one pixel, metres."""
    depth_times_disparity = rig.left.fx * rig.baseline
    offset = rig.right.cx - rig.left.cx if rig.is_rectified else 0.0
    near = (
        None
        if rig.disparity_count is None
        else depth_times_disparity / max(rig.disparity_count + offset, 1.0)
    )
    return near, depth_times_disparity / max(1.0 + offset, 1.0)
