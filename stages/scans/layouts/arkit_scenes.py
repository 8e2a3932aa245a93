"""ARKitScenes, low resolution: 256×192 colour and LiDAR depth.

    lowres_wide/<id>_<seconds>.png   lowres_depth/   confidence/            the same name in each
    lowres_wide_intrinsics/<id>_<seconds>.pincam                            width height fx fy cx cy
    lowres_wide.traj                                                        world-to-camera

Timestamps in names are rounded to milliseconds, not always in the same direction. According to the
authors of the data set, z is up; ARKit itself uses y.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import find_or_guess_camera, get_stated_camera
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    SCAN_FILES_MISSING,
)
from scanloom.stages.scans.image_folders.image_files import IMAGE_SUFFIXES, find_common_size, has_all
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phone_scans import resolve_min_confidence
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame, scale_camera
from scanloom.stages.scans.model.world import Z_UP
from scanloom.stages.scans.trajectory.timed_poses import match_poses_by_time

_UNITS_PER_METRE = 1000.0
_MILLISECOND_NS = 1_000_000
_POSE_TOLERANCE_NS = 5 * _MILLISECOND_NS
_TIME_IN_NAME = re.compile(r"(?:.*_)?(\d{1,9})(?:\.(\d{1,9}))?")
_MAX_SIDE_PX = 1 << 16
# Low, medium and high.
_CONFIDENCE_LEVELS = (0, 1, 2)


def _matches(folder: Path) -> str | None:
    if not has_all(folder, "lowres_depth"):
        return None
    return next(
        (
            f"lowres_depth/ and {name}"
            for name in ("lowres_wide.traj", "lowres_wide_intrinsics", "lowres_wide")
            if has_all(folder, name)
        ),
        None,
    )


def _read(folder: Path, options: ReadingParams) -> Scan:
    depths = _list_by_timestamp(folder / "lowres_depth", IMAGE_SUFFIXES)
    if not depths:
        raise InputError(
            SCAN_FILES_MISSING, "lowres_depth/ has no images named like 41069021_305.377.png.", folder
        )
    colors = _list_by_timestamp(folder / "lowres_wide", IMAGE_SUFFIXES)
    cameras = _list_by_timestamp(folder / "lowres_wide_intrinsics", (".pincam",))
    confidences = _list_by_timestamp(folder / "confidence", IMAGE_SUFFIXES)
    path = options.resolve_file("poses", folder) or folder / "lowres_wide.traj"
    is_posed = path.exists() or options.poses is not None
    size = find_common_size(list(depths.values()))
    stated = get_stated_camera(options, folder, *size)
    if stated is None and not cameras:
        stated, _ = find_or_guess_camera(folder, *size)
    min_confidence = resolve_min_confidence(options, _CONFIDENCE_LEVELS, folder) if confidences else 0
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    moments = [time * _MILLISECOND_NS for time in sorted(depths)]
    poses: list[Pose | None] = [None] * len(moments)
    if is_posed:
        names = [depths[time].stem for time in sorted(depths)]
        poses = match_poses_by_time(path, moments, names, _POSE_TOLERANCE_NS, options)
    for (time, depth), moment, pose in zip(sorted(depths.items()), moments, poses, strict=True):
        color, pincam = _find_at_time(colors, time), _find_at_time(cameras, time)
        camera = stated or (None if pincam is None else _read_camera(pincam, size))
        if pose is None and is_posed:
            skipped.append(
                SkippedFrame(
                    depth.stem, FRAME_POSE_MISSING.warning("the trajectory has no pose within 0.005 s")
                )
            )
            continue
        if camera is None or (color is None and colors):
            lacking = ".pincam" if camera is None else "colour image"
            reason = FRAME_IMAGE_MISSING.warning("its {lacking} is missing", lacking=lacking)
            skipped.append(SkippedFrame(depth.stem, reason))
            continue
        frames.append(
            Frame(
                name=depth.stem,
                camera=camera,
                color=color,
                depth=depth,
                depth_scale=options.depth_scale or _UNITS_PER_METRE,
                world_from_camera=pose,
                timestamp=moment,
                confidence=_find_at_time(confidences, time),
                min_confidence=min_confidence,
            )
        )
    missing = () if is_posed else (describe_missing_poses("lowres_wide.traj is missing"),)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _list_by_timestamp(folder: Path, suffixes: Sequence[str]) -> dict[int, Path]:
    """Return the files of a folder by their timestamp in milliseconds.

    Empty if the folder does not exist.
    """
    if not folder.is_dir():
        return {}
    found = {}
    for path in folder.iterdir():
        time = _TIME_IN_NAME.fullmatch(path.stem)
        if path.suffix.lower() in suffixes and time is not None:
            found[round(float(f"{time[1]}.{time[2] or 0}") * 1000)] = path
    return found


def _find_at_time(files: Mapping[int, Path], time: int) -> Path | None:
    """Return the file of a timestamp, with a tolerance of 1 ms.

    The same moment may be rounded differently in two names.
    """
    return next((files[near] for near in (time, time - 1, time + 1) if near in files), None)


def _read_camera(path: Path, size: tuple[int, int]) -> Camera:
    """Read `width height fx fy cx cy`, scaled to images of `size`."""
    try:
        width, height, *matrix = (float(word) for word in documents.read_text(path).split())
        fx, fy, cx, cy = matrix
    except ValueError as error:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "the file must contain `width height fx fy cx cy`.", path
        ) from error
    if not (1 <= width <= _MAX_SIDE_PX and 1 <= height <= _MAX_SIDE_PX):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the file states an invalid image size of {width:g}×{height:g} pixels.",
            path,
            width=width,
            height=height,
        )
    camera = calibration.check_camera_values(Camera(int(width), int(height), fx, fy, cx, cy), path)
    return scale_camera(camera, *size)


LAYOUT = Layout(
    name="arkitscenes",
    description="lowres_wide/, lowres_depth/, lowres_wide_intrinsics/, lowres_wide.traj (ARKitScenes)",
    matches=_matches,
    read=_read,
    up=Z_UP,
    is_gravity_aligned=True,
)
