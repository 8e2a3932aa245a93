"""Inspection of a scan before processing.

Everything is measured on a few sampled frames, so that inspection takes a second or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from scanloom.stages.adjusting.look import look, usable
from scanloom.stages.adjusting.offset import offset, sights
from scanloom.stages.adjusting.view import color_camera, has_one_camera, place_of_color
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.plan import Plan, make_plan
from scanloom.stages.fusion.upsampling import upsampled_alone
from scanloom.stages.inspecting import sanity
from scanloom.stages.inspecting.camera_path import camera_path
from scanloom.stages.inspecting.codes import CAMERA_COLOR_UNREGISTERED, SCAN_FRAMES_BLURRED
from scanloom.stages.inspecting.depth_seen import SCALES, depth_range, report_markers
from scanloom.stages.inspecting.image_sizes import report_sizes
from scanloom.stages.inspecting.inspection import Inspection
from scanloom.stages.inspecting.outlook import outlook
from scanloom.stages.inspecting.unused import unused
from scanloom.stages.inspecting.view_poses import check_view_poses
from scanloom.stages.registration.focal import focal_of, is_guess, report_focal
from scanloom.stages.registration.focal_by_marks import focal_by_marks
from scanloom.stages.registration.subject import shows_thing
from scanloom.stages.scans.codes import POSE_INCONSISTENT_WITH_IMAGES, SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.model.images import read_color, read_depth, read_right
from scanloom.stages.scans.model.prefetch import workers
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Scan, StereoRig
from scanloom.stages.scans.model.sharpness import least_sharp
from scanloom.stages.scans.transforms.up import known_up

_SAMPLED = 8
# Sharpness relative to the median frame, below which a frame is reported as blurred.
_BLURRED = 0.25
# Pixels. Above this median misalignment between frames, colour detail is lost.
_MISFIT_PX = 1.5


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
    samples = _samples(scan)
    path, up = camera_path(scan), known_up(scan)
    report_sizes(scan)
    depth, stereo_depth = None, None
    errors: dict[str, float] = {}
    misfit = None
    if scan.rig is not None and scan.rig.left.is_calibrated:
        stereo_depth = _stereo_depth(scan.rig)
        sanity.report_pairs([(one.color, one.right) for one in samples], scan.rig)
    elif scan.is_views:
        suspicion = None if path is None else check_view_poses(scan.frames)[1]
        if suspicion is not None:
            emit(suspicion)
    elif scan.rig is None:
        about_scale = None if path is None or not scan.is_metric else sanity.check_scale(scan.frames, SCALES)
        depth = depth_range([one.depth for one in samples], scan, with_hints=about_scale is None)
        report_markers([one.frame for one in samples])
        errors, suspicion = ({}, None) if path is None else sanity.check_poses(scan.frames)
        # A wrong depth unit also makes the poses look wrong, so the unit is reported first.
        suspicion = about_scale or suspicion
        if suspicion is not None:
            emit(suspicion)
        _report_unregistered(scan.frames)
        misfit = _misfit(scan.frames)
        if path is not None and misfit is None and suspicion is None:
            sanity.pose_doubts(scan.frames)
    sharpness = _least_sharp(scan)
    plan = _plan(scan) if depth is not None and path is not None else None
    subject = None
    if depth is not None and path is None and len(scan.frames) > 1:
        subject = "object" if shows_thing(scan.frames) else "scene"
    focal = None
    if depth is not None and len(scan.frames) > 1 and is_guess(scan.frames):
        focal = focal_of(scan.frames)
        if focal is None and subject == "object":
            focal = focal_by_marks(scan.frames)
        report_focal(focal, scan.frames[0].camera)
    return Inspection(
        scan=scan,
        color_size=_color_size(samples),
        path=path,
        depth=depth,
        stereo_depth_m=stereo_depth,
        misfit_px=misfit,
        pose_errors_m=errors,
        least_sharp=sharpness,
        scene=None if plan is None else plan.scene,
        outlook=None if plan is None else outlook(scan.frames, plan),
        up=up,
        subject=subject,
        focal=focal,
        unused=unused(scan),
    )


@dataclass(frozen=True, eq=False)
class _Sample:
    frame: Frame
    color: ColorImage | None
    right: ColorImage | None
    depth: DepthImage | None


def _samples(scan: Scan) -> list[_Sample]:
    """Read frames evenly sampled over the scan; warn about unreadable ones."""
    chosen = sample_evenly(len(scan.frames), _SAMPLED)
    found = [_sample(scan.frames[i]) for i in chosen]
    samples = [one for one in found if isinstance(one, _Sample)]
    faults = [one for one in found if isinstance(one, InputError)]
    if not samples:
        raise faults[0]
    for error in faults:
        emit(SCAN_FRAMES_SKIPPED.warning("a sampled frame cannot be used: {reason}", reason=str(error)))
    return samples


def _sample(frame: Frame) -> _Sample | InputError:
    try:
        return _Sample(frame, read_color(frame), read_right(frame), read_depth(frame))
    except InputError as error:
        return error


def _misfit(frames: Sequence[Frame]) -> float | None:
    """Measure the median reprojection error between frames, pixels.

    Emits a warning if it is large. Returns None if it cannot be measured.
    """
    places = usable(frames)
    seen = look(frames, places) if len(places) > 1 else None
    if seen is None or seen.trouble:
        return None
    if seen.median >= _MISFIT_PX:
        emit(
            POSE_INCONSISTENT_WITH_IMAGES.warning(
                "colour, depth and poses are misaligned by {off:.1f} px (median of {count:,} points seen in "
                "two frames): `scanloom run` corrects them, `scanloom adjust` does only that",
                off=seen.median,
                count=len(seen.errors),
            )
        )
    return seen.median


def _report_unregistered(frames: Sequence[Frame]) -> None:
    """Warn if photos are offset from depth maps, judged by silhouettes."""
    both = [n for n, frame in enumerate(frames) if frame.color is not None and frame.depth is not None]
    if not both or not has_one_camera([frames[n] for n in both]):
        return
    first = frames[both[0]]
    found = offset(sights(frames, both), color_camera(first), place_of_color(first))
    if found is not None and found.is_clear:
        emit(
            CAMERA_COLOR_UNREGISTERED.warning(
                "colour is not registered to depth: judged by silhouettes, the photos are shifted {shift}",
                remedy=(
                    "if frames have poses, `scanloom run` corrects the colour camera, `scanloom adjust` does "
                    "only that"
                ),
                shift=found.said,
            )
        )


def _least_sharp(scan: Scan) -> tuple[tuple[str, float], ...]:
    worst, measured = least_sharp(scan.frames)
    named = tuple((frame.name, value) for frame, value in worst)
    blurred = [name for name, value in named if value < _BLURRED]
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


def _plan(scan: Scan) -> Plan | None:
    params = FuseParams()
    try:
        # Fusion emits the warnings of its plan itself.
        with collecting(forward=False):
            return make_plan(upsampled_alone(scan.frames, params), params, scan.folder, workers())
    except InputError:
        return None


def _color_size(samples: Sequence[_Sample]) -> tuple[int, int] | None:
    color = next((one.color for one in samples if one.color is not None), None)
    return None if color is None else (color.shape[1], color.shape[0])


def _stereo_depth(rig: StereoRig) -> tuple[float | None, float]:
    """Compute the depth at the largest disparity (None if unknown) and at one pixel, metres."""
    strength = rig.left.fx * rig.baseline
    offset = rig.right.cx - rig.left.cx if rig.rectified else 0.0
    near = None if rig.disparities is None else strength / max(rig.disparities + offset, 1.0)
    return near, strength / max(1.0 + offset, 1.0)
