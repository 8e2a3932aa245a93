"""Look at a scan before any work is done: what is there, and what is odd about it.

Everything is measured on a handful of frames, so that a person gets the answer in a second or two.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stages.adjusting.look import look, usable
from stages.errors import InputError
from stages.files.images import image_size, read_raw_depth
from stages.fusion.params import FuseParams
from stages.fusion.plan import Plan, make_plan
from stages.fusion.posed_depth import read_matching_color
from stages.fusion.scene import Scene, in_words
from stages.fusion.upsampling import upsampled_alone
from stages.inspecting import sanity
from stages.inspecting.outlook import Outlook, outlook
from stages.inspecting.unused import Unused, unused
from stages.printing import by_fields, by_figures, table
from stages.registration.focal import Focal, focal_of, focal_warnings, is_guess
from stages.registration.focal_by_marks import focal_by_marks
from stages.registration.subject import shows_thing
from stages.scans.images import read_color, read_depth, read_right
from stages.scans.prefetch import workers
from stages.scans.scan import Camera, ColorImage, DepthImage, Frame, Scan, StereoRig
from stages.scans.sharpness import least_sharp
from stages.scans.up import known_up
from stages.scans.world import Scale, WorldUp

_SAMPLED = 8
# Of files that nobody used, so many are named to a person.
_SHOWN = 12
# A person walking with a camera does not move faster between two frames.
_LARGEST_STEP_M = 0.5
_LARGEST_TURN_DEG = 30.0
_PLAUSIBLE_M = (0.1, 20.0)
# A frame so much less sharp than the usual one shows hardly any of its edges.
_BLURRED = 0.25
# Where points of two frames lie so far apart, details of the colours are lost.
_MISFIT_PX = 1.5
# Units a metre of the layouts in use, for a hint when the depth cannot be right.
_SCALES = {
    1000.0: "millimetres",
    10000.0: "tenths of millimetres",
    4000.0: "quarters of millimetres",
    5000.0: "TUM RGB-D",
    6553.5: "Replica",
    256.0: "KITTI depth",
    80000.0: "tenths of millimetres, bits rotated",
    1.0: "metres",
}


@dataclass(frozen=True)
class Path3D:
    """The way of the camera: lengths in metres, angles in degrees.

    `outliers` are frames that a larger step (0.5 m or 30 degrees, or five usual steps) leads to.
    """

    length_m: float
    box_m: tuple[float, float, float]
    largest_step_m: float
    largest_turn_deg: float
    outliers: tuple[str, ...]

    __repr__ = by_fields


@dataclass(frozen=True)
class DepthRange:
    """Depth of the sampled frames: percentiles in metres, the share of pixels without a value (0 to 1)."""

    sampled_frames: int
    near_m: float
    median_m: float
    far_m: float
    missing_share: float

    __repr__ = by_fields


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a scan holds.

    Attributes
    ----------
    scan : what was inspected.
    color_size : (width, height) of the colour (left) images, pixels; None without colour.
    path : of the camera; None without poses.
    depth : of RGB-D scans, None when no sampled frame has any.
    stereo_depth_m : for calibrated pairs: the depth at the largest stated disparity (or None) and at one
        pixel.
    misfit_px : how far from its match a point that two frames show lands by depth and poses, median; None if
        not measured.
    pose_errors_m : median depth error after reprojection, by how the poses are taken; empty if not measured.
    least_sharp : the least sharp twentieth of the frames with colour, the worst first, each with the variance
        of its image's Laplacian over the median frame's; of long scans, of a sample.
    scene : where what the frames show lies in the scan's world, of RGB-D scans with poses.
    outlook : what fusing takes, of the same.
    subject : what poses will be found for, `scene`, or the `object` that moves before a camera that stands
        still; None where there are poses, or no depth maps.
    focal : of the depth camera, where nobody states it and the frames tell it.
    up : which way is up in the world of the poses; None where neither layout nor accelerometer says it.
    warnings : all that is odd, the reader's own first.
    unused : files of the folder that nobody used.
    """

    scan: Scan
    color_size: tuple[int, int] | None
    path: Path3D | None
    depth: DepthRange | None
    stereo_depth_m: tuple[float | None, float] | None
    misfit_px: float | None
    pose_errors_m: dict[str, float]
    least_sharp: tuple[tuple[str, float], ...]
    scene: Scene | None
    outlook: Outlook | None
    up: WorldUp | None
    warnings: tuple[str, ...]
    subject: str | None = None
    focal: Focal | None = None
    unused: tuple[Unused, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return everything as what JSON can hold; units are in the names.

        Where the scan is not `metric`, metres are the unit of its world.
        """
        scan = self.scan
        camera = scan.frames[0].camera
        rig = scan.rig
        return {
            "layout": scan.layout,
            "kind": "stereo" if scan.is_stereo else "views" if scan.is_views else "rgbd",
            "frames": len(scan.frames),
            "skipped": [{"frame": one.name, "reason": one.reason} for one in scan.skipped],
            "camera": dataclasses.asdict(camera) if camera.is_calibrated else None,
            "color_size_px": self.color_size,
            "subject": self.subject,
            "focal": self.focal and self.focal.figures(),
            "metric": scan.is_metric,
            "scale": scan.scale and scan.scale.figures(),
            **(self.up.figures() if self.up else {"up": None, "up_source": None}),
            "depth_scale_per_m": None if scan.is_stereo or scan.is_views else scan.frames[0].depth_scale,
            "rig": {
                "right_camera": dataclasses.asdict(rig.right),
                "baseline_m": rig.baseline,
                "rectified": rig.rectified,
                "disparities_px": rig.disparities,
            }
            if rig is not None and rig.left.is_calibrated
            else None,
            "path": self.path and dataclasses.asdict(self.path),
            "depth": self.depth and dataclasses.asdict(self.depth),
            "stereo_depth_m": self.stereo_depth_m
            and {"largest_disparity": self.stereo_depth_m[0], "one_pixel": self.stereo_depth_m[1]},
            "misfit_px": self.misfit_px,
            "pose_errors_m": self.pose_errors_m,
            "least_sharp": [{"frame": name, "of_median": value} for name, value in self.least_sharp],
            "scene": self.scene and dataclasses.asdict(self.scene),
            "outlook": self.outlook and dataclasses.asdict(self.outlook),
            "missing": list(scan.missing),
            "warnings": list(self.warnings),
            "unused": [dataclasses.asdict(one) for one in self.unused],
        }

    def lines(self) -> list[str]:
        """Return the same as lines of text for a person."""
        scan, camera = self.scan, self.scan.frames[0].camera
        single = "single views" if scan.is_views else "colour and depth"
        kind = "stereo pairs" if scan.is_stereo else single
        m = "m" if scan.is_metric else "units"
        lines = [
            f"layout    {scan.layout}: {kind}",
            f"frames    {len(scan.frames)}" + (f", {len(scan.skipped)} left out" if scan.skipped else ""),
            f"camera    {_camera_words(camera)}",
        ]
        if not scan.is_metric:
            lines.append("scale     none: lengths are in units of the scan's own world")
        if scan.scale is not None:
            lines.append(f"scale     {_scale_words(scan.scale)}")
        if self.up is not None:
            x, y, z = self.up.direction
            lines.append(f"up        {x:.3g} {y:.3g} {z:.3g}, by {self.up.source}")
        if self.color_size and self.color_size != (camera.width, camera.height):
            lines.append(f"colour    {self.color_size[0]}×{self.color_size[1]} px")
        if scan.rig is not None and camera.is_calibrated:
            state = "rectified" if scan.rig.rectified else "not rectified"
            lines.append(f"rig       baseline {scan.rig.baseline:.4f} m, {state}")
        if self.path is not None and len(scan.frames) > 1:
            box = " × ".join(f"{side:.2f}" for side in self.path.box_m)
            lines.append(
                f"path      {self.path.length_m:.2f} {m} in a box of {box} {m}; "
                f"largest step {self.path.largest_step_m:.3f} {m}, {self.path.largest_turn_deg:.1f}°"
            )
        if self.depth is not None:
            lines.append(
                f"depth     {self.depth.near_m:.2f} to {self.depth.far_m:.2f} {m} (2nd to 98th percentile), "
                f"median {self.depth.median_m:.2f} {m}; {self.depth.missing_share:.0%} missing "
                f"(in {self.depth.sampled_frames} of {len(scan.frames)} frames)"
            )
        if self.stereo_depth_m is not None:
            near, far = self.stereo_depth_m
            start = "" if near is None else f"{near:.2f} m at the largest disparity, "
            lines.append(f"depth     {start}{far:.1f} m at a disparity of one pixel")
        if self.pose_errors_m:
            ways = sorted(self.pose_errors_m.items(), key=lambda way: way[1])
            words = " and ".join(
                (f"{error * 1000:.0f} mm" if scan.is_metric else f"{error:.2g} units") + f" {name}"
                for name, error in ways[:2]
            )
            lines.append(
                f"poses     depth of one frame meets another's to {words} (median, the best two ways)"
            )
        if self.subject == "object":
            lines.append(
                "subject   a thing that moves before a camera that stands still: `scanloom run` registers it "
                "alone, all that is seen with register.subject=scene"
            )
        if self.misfit_px is not None:
            lines.append(f"misfit    points that two frames show lie {self.misfit_px:.2g} px apart (median)")
        if self.least_sharp:
            words = ", ".join(f"{name} ({value:.0%})" for name, value in self.least_sharp[:5])
            lines.append(f"sharpness least in {words} of the median frame's")
        if self.scene is not None:
            lines += [
                f"extent    {self.scene} m, lowest to highest corner (1st to 99th percentile)",
                f"looks at  {in_words(self.scene.center_m)} m, the centre of view",
            ]
        if self.outlook is not None:
            needs = self.outlook
            lines.append(
                f"fusion    about {needs.triangles:,} triangles at voxels of {needs.voxel_size_m:g} {m}; "
                f"{needs.volume_mb:.0f} MB of memory, {needs.disk_mb:.0f} MB on disk"
            )
        found = "" if scan.is_views else "; without, `scanloom run` finds them"
        lines += [f"missing   {text}{found if text.startswith('poses:') else ''}" for text in scan.missing]
        lines += [f"left out  {one.name}: {one.reason}" for one in scan.skipped[:5]]
        if len(scan.skipped) > 5:
            lines.append(f"left out  and {len(scan.skipped) - 5} more")
        lines += [f"warning   {text}" for text in self.warnings]
        lines += [f"not used  {one}" for one in self.unused[:_SHOWN]]
        if len(self.unused) > _SHOWN:
            lines.append(f"not used  and {len(self.unused) - _SHOWN} more")
        return lines


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
    path, said = _path(scan)
    up, about_up = known_up(scan)
    # Single views are taken in no order: from one to the next is no step.
    warnings += ([] if scan.is_views else said) + about_up + _odd_sizes(scan)
    depth, stereo_depth = None, None
    errors: dict[str, float] = {}
    misfit = None
    if scan.rig is not None and scan.rig.left.is_calibrated:
        stereo_depth = _stereo_depth(scan.rig)
        warnings += sanity.check_pairs([(one.color, one.right) for one in samples], scan.rig)
    elif scan.rig is None and not scan.is_views:
        about_scale = [] if path is None or not scan.is_metric else sanity.check_scale(scan.frames, _SCALES)
        depth, said = _depth_range([one.depth for one in samples], scan, with_hints=not about_scale)
        errors, about_poses = ({}, []) if path is None else sanity.check_poses(scan.frames)
        # Poses that only seem to be meant another way, because depth is of another unit.
        about_poses = about_scale or about_poses
        misfit, about_misfit = _misfit(scan.frames)
        pairs = [(_matching(one), one.depth) for one in samples]
        warnings += said + _markers(samples) + about_poses + sanity.check_registration(pairs) + about_misfit
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
    chosen = np.unique(np.linspace(0, len(scan.frames) - 1, _SAMPLED).round().astype(int))
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


def _matching(sample: _Sample) -> ColorImage | None:
    """Return the colour as the depth camera sees it, where the two are known apart."""
    if sample.color is None or sample.depth is None or sample.frame.color_camera is None:
        return sample.color
    return read_matching_color(sample.frame, sample.depth)


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


def _path(scan: Scan) -> tuple[Path3D | None, list[str]]:
    frames = scan.frames
    poses = np.array([frame.world_from_camera for frame in frames if frame.world_from_camera is not None])
    if not len(poses):
        return None, []
    centres, rotations = poses[:, :3, 3], poses[:, :3, :3]
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    cosines = (np.einsum("nij,nij->n", rotations[:-1], rotations[1:]) - 1) / 2
    turns = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    # A car makes a metre a frame: a step is odd when it is large both as such and for this scan.
    least = _LARGEST_STEP_M if scan.is_metric else 0.0
    limit = max(least, 5 * float(np.median(steps))) if len(steps) else 0.0
    jumps = np.flatnonzero((steps > limit) | (turns > _LARGEST_TURN_DEG))
    outliers = tuple(frames[i + 1].name for i in jumps)
    box = np.ptp(centres, axis=0)
    path = Path3D(
        length_m=float(steps.sum()),
        box_m=(float(box[0]), float(box[1]), float(box[2])),
        largest_step_m=float(steps.max(initial=0.0)),
        largest_turn_deg=float(turns.max(initial=0.0)),
        outliers=outliers,
    )
    if not outliers:
        return path, []
    named = ", ".join(outliers[:3]) + (" …" if len(outliers) > 3 else "")
    return path, [
        f"{len(outliers)} poses jump, by more than {limit:.2g} {'m' if scan.is_metric else 'units'} or "
        f"{_LARGEST_TURN_DEG:g}° from the one before: {named}"
    ]


def _odd_sizes(scan: Scan) -> list[str]:
    """Compare the sizes in the headers of all images of each stream."""
    warnings = []
    for stream in ("color", "right", "depth"):
        sizes: dict[tuple[int, int] | None, list[Path]] = {}
        for frame in scan.frames:
            image = getattr(frame, stream)
            if isinstance(image, Path):
                sizes.setdefault(_size_or_none(image), []).append(image)
        unread = sizes.pop(None, [])
        if unread:
            warnings.append(f"{len(unread)} {stream} images cannot be read, the first is {unread[0].name}")
        usual = max(sizes, key=lambda size: len(sizes[size]), default=None)
        odd = {size: paths for size, paths in sizes.items() if size != usual}
        if len(odd) == 1:
            ((size, paths),) = odd.items()
            warnings.append(
                f"{len(paths)} {stream} images have another size ({_size_words(size)}), the first is "
                f"{paths[0].name}"
            )
        elif odd:
            count = sum(map(len, odd.values()))
            shown = ", ".join(map(_size_words, list(odd)[:3])) + (" …" if len(odd) > 3 else "")
            warnings.append(
                f"{count} {stream} images have {len(odd)} other sizes ({shown}) than most "
                f"({_size_words(usual)})"
            )
    return warnings


def _size_words(size: tuple[int, int] | None) -> str:
    return "" if size is None else f"{size[0]}×{size[1]}"


def _size_or_none(path: Path) -> tuple[int, int] | None:
    try:
        return image_size(path)
    except InputError:
        return None


def _depth_range(
    maps: Sequence[DepthImage | None], scan: Scan, *, with_hints: bool
) -> tuple[DepthRange | None, list[str]]:
    present = [depth for depth in maps if depth is not None]
    if not present:
        return None, ["no sampled frame has a depth map"]
    values = np.concatenate([depth.ravel() for depth in present])
    valid = values[values > 0]
    if not valid.size:
        return None, ["no pixel of the sampled frames has a depth; all are 0 or missing"]
    near, median, far = (float(value) for value in np.percentile(valid, (2, 50, 98)))
    measured = DepthRange(len(present), near, median, far, 1 - valid.size / values.size)
    low, high = _PLAUSIBLE_M
    if low <= median <= high or not scan.is_metric:
        return measured, []
    scale = scan.frames[0].depth_scale
    hints = [
        f"{other:g} ({name})"
        for other, name in _SCALES.items()
        if other != scale and 0.3 <= median * scale / other <= 8
    ]
    advice = (
        f"; scan.depth_scale={' or '.join(hints)} would make it plausible" if hints and with_hints else ""
    )
    return measured, [f"the median depth is {median:.3g} m with {scale:g} units a metre{advice}"]


def _markers(samples: Sequence[_Sample]) -> list[str]:
    """Find a raw value at the top of the range that fills more than 1 % of the pixels: surely no depth."""
    raws = [
        (one.frame, read_raw_depth(one.frame.depth)) for one in samples if isinstance(one.frame.depth, Path)
    ]
    raws = [(frame, raw) for frame, raw in raws if raw.dtype.kind == "u"]
    if not raws:
        return []
    top = max(int(raw.max(initial=0)) for _, raw in raws)
    share = sum(np.count_nonzero(raw == top) for _, raw in raws) / sum(raw.size for _, raw in raws)
    if share <= 0.01 or top in (0, *raws[0][0].depth_missing):
        return []
    return [f"{share:.0%} of the depth pixels hold the largest value, {top}; probably it marks a missing one"]


def _color_size(samples: Sequence[_Sample]) -> tuple[int, int] | None:
    color = next((one.color for one in samples if one.color is not None), None)
    return None if color is None else (color.shape[1], color.shape[0])


def _stereo_depth(rig: StereoRig) -> tuple[float | None, float]:
    """Return the depth at the largest disparity the calibration states, and at one pixel."""
    strength = rig.left.fx * rig.baseline
    offset = rig.right.cx - rig.left.cx if rig.rectified else 0.0
    near = None if rig.disparities is None else strength / max(rig.disparities + offset, 1.0)
    return near, strength / max(1.0 + offset, 1.0)


def _scale_words(scale: Scale) -> str:
    spread = "" if scale.spread_share is None else f", which differ by {scale.spread_share:.1%} at most"
    return f"{scale.metres_per_unit:.6g} m a unit, {scale.source}{spread}"


def _camera_words(camera: Camera) -> str:
    if not camera.is_calibrated:
        return f"{camera.width}×{camera.height} px"
    kind = "fisheye " if camera.fisheye else ""
    bent = f", {kind}distortion {' '.join(f'{k:g}' for k in camera.distortion)}" if camera.distortion else ""
    return (
        f"{camera.width}×{camera.height} px, focal length {camera.fx:.2f} {camera.fy:.2f} px, "
        f"centre {camera.cx:.2f} {camera.cy:.2f} px{bent}"
    )
