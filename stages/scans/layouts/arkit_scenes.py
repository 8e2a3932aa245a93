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
from scanloom.stages.scans.calibration.resolution import found_camera, stated_camera
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    SCAN_FILES_MISSING,
)
from scanloom.stages.scans.image_folders.image_files import IMAGES, common_size, has
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phones import least_confidence
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame, scaled
from scanloom.stages.scans.model.world import Z_UP
from scanloom.stages.scans.trajectory.timed_poses import poses_at

_UNITS_PER_METRE = 1000.0
_MILLISECOND = 1_000_000
_POSE_TOLERANCE = 5 * _MILLISECOND
_TIME = re.compile(r"(?:.*_)?(\d{1,9})(?:\.(\d{1,9}))?")
_LARGEST_SIDE = 1 << 16
# Low, medium and high.
_LEVELS = (0, 1, 2)


def _matches(folder: Path) -> str | None:
    if not has(folder, "lowres_depth"):
        return None
    return next(
        (
            f"lowres_depth/ and {name}"
            for name in ("lowres_wide.traj", "lowres_wide_intrinsics", "lowres_wide")
            if has(folder, name)
        ),
        None,
    )


def _read(folder: Path, options: ReadingParams) -> Scan:
    depths = _by_time(folder / "lowres_depth", IMAGES)
    if not depths:
        raise InputError(
            SCAN_FILES_MISSING, "lowres_depth/ has no images named like 41069021_305.377.png.", folder
        )
    colors = _by_time(folder / "lowres_wide", IMAGES)
    cameras = _by_time(folder / "lowres_wide_intrinsics", (".pincam",))
    confidences = _by_time(folder / "confidence", IMAGES)
    path = options.file("poses", folder) or folder / "lowres_wide.traj"
    is_posed = path.exists() or options.poses is not None
    size = common_size(list(depths.values()))
    stated = stated_camera(options, folder, *size)
    if stated is None and not cameras:
        stated, _ = found_camera(folder, *size)
    least = least_confidence(options, _LEVELS, folder) if confidences else 0
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    moments = [time * _MILLISECOND for time in sorted(depths)]
    poses: list[Pose | None] = [None] * len(moments)
    if is_posed:
        names = [depths[time].stem for time in sorted(depths)]
        poses = poses_at(path, moments, names, _POSE_TOLERANCE, options)
    for (time, depth), moment, pose in zip(sorted(depths.items()), moments, poses, strict=True):
        color, pincam = _beside(colors, time), _beside(cameras, time)
        camera = stated or (None if pincam is None else _camera(pincam, size))
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
                confidence=_beside(confidences, time),
                least_confidence=least,
            )
        )
    missing = () if is_posed else (poses_missing("lowres_wide.traj is missing"),)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _by_time(folder: Path, suffixes: Sequence[str]) -> dict[int, Path]:
    """Return the files of a folder by their timestamp in milliseconds.

    Empty if the folder does not exist.
    """
    if not folder.is_dir():
        return {}
    found = {}
    for path in folder.iterdir():
        time = _TIME.fullmatch(path.stem)
        if path.suffix.lower() in suffixes and time is not None:
            found[round(float(f"{time[1]}.{time[2] or 0}") * 1000)] = path
    return found


def _beside(files: Mapping[int, Path], time: int) -> Path | None:
    """Return the file of a timestamp, with a tolerance of 1 ms.

    The same moment may be rounded differently in two names.
    """
    return next((files[near] for near in (time, time - 1, time + 1) if near in files), None)


def _camera(path: Path, size: tuple[int, int]) -> Camera:
    """Read `width height fx fy cx cy`, scaled to images of `size`."""
    try:
        width, height, *matrix = (float(word) for word in documents.read_text(path).split())
        fx, fy, cx, cy = matrix
    except ValueError as error:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "the file must contain `width height fx fy cx cy`.", path
        ) from error
    if not (1 <= width <= _LARGEST_SIDE and 1 <= height <= _LARGEST_SIDE):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the file states an invalid image size of {width:g}×{height:g} pixels.",
            path,
            width=width,
            height=height,
        )
    camera = calibration.checked(Camera(int(width), int(height), fx, fy, cx, cy), path)
    return scaled(camera, *size)


LAYOUT = Layout(
    name="arkitscenes",
    text="lowres_wide/, lowres_depth/, lowres_wide_intrinsics/, lowres_wide.traj (ARKitScenes)",
    matches=_matches,
    read=_read,
    up=Z_UP,
    is_level=True,
)
