"""Look at a scan before any work is done: what is there, and what is odd about it.

Everything is measured on a handful of frames, so that a person gets the answer in a second or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stages.adjusting.look import look, usable
from stages.adjusting.offset import offset, sights
from stages.adjusting.view import color_camera, has_one_camera, place_of_color
from stages.diagnostics.errors import InputError
from stages.frames.sampling import sample_evenly
from stages.fusion.params import FuseParams
from stages.fusion.plan import Plan, make_plan
from stages.fusion.upsampling import upsampled_alone
from stages.inspecting import sanity
from stages.inspecting.camera_path import camera_path
from stages.inspecting.depth_seen import SCALES, depth_range, markers
from stages.inspecting.image_sizes import odd_sizes
from stages.inspecting.inspection import Inspection
from stages.inspecting.outlook import outlook
from stages.inspecting.unused import unused
from stages.inspecting.view_poses import check_view_poses
from stages.registration.focal import focal_of, focal_warnings, is_guess
from stages.registration.focal_by_marks import focal_by_marks
from stages.registration.subject import shows_thing
from stages.scans.images import read_color, read_depth, read_right
from stages.scans.prefetch import workers
from stages.scans.scan import ColorImage, DepthImage, Frame, Scan, StereoRig
from stages.scans.sharpness import least_sharp
from stages.scans.up import known_up

_SAMPLED = 8
# A frame so much less sharp than the usual one shows hardly any of its edges.
_BLURRED = 0.25
# Where points of two frames lie so far apart, details of the colours are lost.
_MISFIT_PX = 1.5


def inspect(scan: Scan) -> Inspection:
    """Measure a scan on a sample of its frames.

    Parameters
    ----------
    scan : with at least one frame, and perhaps without poses or calibration (see `Scan.missing`); its images
        are read, never changed.

    Returns
    -------
    Inspection

    Raises
    ------
    InputError
        If not one of the sampled frames can be read.
    """
    samples, warnings = _samples(scan)
    path, said = camera_path(scan)
    up, about_up = known_up(scan)
    # Single views are taken in no order: from one to the next is no step.
    warnings += ([] if scan.is_views else said) + about_up + odd_sizes(scan)
    depth, stereo_depth = None, None
    errors: dict[str, float] = {}
    misfit = None
    if scan.rig is not None and scan.rig.left.is_calibrated:
        stereo_depth = _stereo_depth(scan.rig)
        warnings += sanity.check_pairs([(one.color, one.right) for one in samples], scan.rig)
    elif scan.is_views:
        warnings += [] if path is None else check_view_poses(scan.frames)[1]
    elif scan.rig is None:
        about_scale = [] if path is None or not scan.is_metric else sanity.check_scale(scan.frames, SCALES)
        depth, said = depth_range([one.depth for one in samples], scan, with_hints=not about_scale)
        errors, about_poses = ({}, []) if path is None else sanity.check_poses(scan.frames)
        # Poses that only seem to be meant another way, because depth is of another unit.
        about_poses = about_scale or about_poses
        misfit, about_misfit = _misfit(scan.frames)
        if path is not None and misfit is None and not about_poses:
            about_poses = sanity.pose_doubts(scan.frames)
        warnings += (
            said
            + markers([one.frame for one in samples])
            + about_poses
            + _unregistered(scan.frames)
            + about_misfit
        )
    sharpness, about_sharpness = _least_sharp(scan)
    plan = _plan(scan) if depth is not None and path is not None else None
    subject = None
    if depth is not None and path is None and len(scan.frames) > 1:
        subject = "object" if shows_thing(scan.frames) else "scene"
    focal = None
    if depth is not None and len(scan.frames) > 1 and is_guess(scan.frames):
        focal = focal_of(scan.frames)
        if focal is None and subject == "object":
            focal = focal_by_marks(scan.frames)
        warnings += focal_warnings(focal, scan.frames[0].camera)
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
        warnings=(*scan.warnings, *warnings, *about_sharpness),
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


def _samples(scan: Scan) -> tuple[list[_Sample], list[str]]:
    """Read a few frames spread over the scan; what cannot be read is told."""
    chosen = sample_evenly(len(scan.frames), _SAMPLED)
    found = [_sample(scan.frames[i]) for i in chosen]
    samples = [one for one in found if isinstance(one, _Sample)]
    faults = [one for one in found if isinstance(one, InputError)]
    if not samples:
        raise faults[0]
    return samples, [f"a sampled frame cannot be used: {error}" for error in faults]


def _sample(frame: Frame) -> _Sample | InputError:
    try:
        return _Sample(frame, read_color(frame), read_right(frame), read_depth(frame))
    except InputError as error:
        return error


def _misfit(frames: Sequence[Frame]) -> tuple[float | None, list[str]]:
    """Return how far from its match a point of one frame lands in another, pixels, and what helps."""
    places = usable(frames)
    seen = look(frames, places) if len(places) > 1 else None
    if seen is None or seen.trouble:
        return None, []
    if seen.median < _MISFIT_PX:
        return seen.median, []
    return seen.median, [
        f"colour, depth and poses are off by {seen.median:.1f} px (median of {len(seen.errors):,} points "
        "that two frames show): `scanloom run` adjusts them, `scanloom adjust` does it alone"
    ]


def _unregistered(frames: Sequence[Frame]) -> list[str]:
    """Say where photos lie beside depth, by the outlines of things."""
    both = [n for n, frame in enumerate(frames) if frame.color is not None and frame.depth is not None]
    if not both or not has_one_camera([frames[n] for n in both]):
        return []
    first = frames[both[0]]
    found = offset(sights(frames, both), color_camera(first), place_of_color(first))
    if found is None or not found.is_clear:
        return []
    return [
        f"colour is not registered to depth: by the outlines of things photos lie {found.said}; where frames "
        "have poses, `scanloom run` moves the colour camera there, `scanloom adjust` does it alone"
    ]


def _least_sharp(scan: Scan) -> tuple[tuple[tuple[str, float], ...], list[str]]:
    worst, measured = least_sharp(scan.frames)
    named = tuple((frame.name, value) for frame, value in worst)
    blurred = [name for name, value in named if value < _BLURRED]
    if not blurred:
        return named, []
    shown = ", ".join(blurred[:3]) + (" …" if len(blurred) > 3 else "")
    return named, [
        f"blurred, or with next to nothing to see: {shown} "
        f"({len(blurred)} of the {measured} frames looked at)"
    ]


def _plan(scan: Scan) -> Plan | None:
    try:
        params = FuseParams()
        return make_plan(upsampled_alone(scan.frames, params), params, scan.folder, workers())
    except InputError:
        return None


def _color_size(samples: Sequence[_Sample]) -> tuple[int, int] | None:
    color = next((one.color for one in samples if one.color is not None), None)
    return None if color is None else (color.shape[1], color.shape[0])


def _stereo_depth(rig: StereoRig) -> tuple[float | None, float]:
    """Return the depth at the largest disparity the calibration states, and at one pixel."""
    strength = rig.left.fx * rig.baseline
    offset = rig.right.cx - rig.left.cx if rig.rectified else 0.0
    near = None if rig.disparities is None else strength / max(rig.disparities + offset, 1.0)
    return near, strength / max(1.0 + offset, 1.0)
