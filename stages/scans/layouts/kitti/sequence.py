"""KITTI odometry: rectified pairs in numbered folders, calib.txt, one pose per line.

Raw recordings have the same pairs in image_02/data/ and image_03/data/, calib_cam_to_cam.txt in the
parent folder, and poses of the car in oxts/. If only one camera is present, its images are single
views.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import CAMERA_PAIR_UNCALIBRATED, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import (
    check_order,
    common_size,
    first_existing,
    has,
    images,
    pair,
)
from scanloom.stages.scans.layouts.kitti.oxts import unit_poses
from scanloom.stages.scans.layouts.kitti.projections import (
    projected_camera,
    projected_rig,
    read_projections,
    rectified_size,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.views import single_view
from scanloom.stages.scans.model.lacking import calibration_missing, poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.world import Z_UP, WorldUp, up_of_layout
from scanloom.stages.scans.streams.stereo_rigs import uncalibrated
from scanloom.stages.scans.trajectory import files as trajectories

# Left folder, right folder, number of the left projection matrix. Colour cameras are preferred.
_CAMERAS = (
    ("image_2", "image_3", 2),
    ("image_02/data", "image_03/data", 2),
    ("image_0", "image_1", 0),
    ("image_00/data", "image_01/data", 0),
    ("image_l", "image_r", 0),
)
# Raw recordings share one calibration between all drives of a day.
_CALIBRATIONS = ("calib.txt", "calib_cam_to_cam.txt", "../calib_cam_to_cam.txt")


def _matches(folder: Path) -> str | None:
    calib = first_existing(folder, *_CALIBRATIONS)
    for left, right, _ in _CAMERAS:
        if has(folder, left, right) and (left != "image_l" or has(folder, "calib.txt")):
            return f"{left}/ and {right}/" + (f" with {calib.name}" if calib else "")
    if calib is None:
        return None
    try:
        alone = _alone(folder, read_projections(calib))
    except InputError:
        # Other layouts also have files of this name.
        return None
    return None if alone is None else f"{alone[0]}/ with {calib.name}"


def _alone(folder: Path, projections: Collection[int]) -> tuple[str, int] | None:
    """Return the image folder and number of a single calibrated camera."""
    for left, right, at in _CAMERAS:
        for name, number in ((left, at), (right, at + 1)):
            if has(folder, name) and number in projections:
                return name, number
    return None


def _read(folder: Path, options: ReadingParams) -> Scan:
    calib = options.file("calibration", folder) or first_existing(folder, *_CALIBRATIONS)
    if calib is not None and not any(has(folder, *names[:2]) for names in _CAMERAS):
        return _read_views(folder, options, calib)
    projections = {} if calib is None else read_projections(calib)
    left, right, at = next(
        (
            names
            for names in _CAMERAS
            if has(folder, *names[:2]) and (calib is None or {names[2], names[2] + 1} <= projections.keys())
        ),
        (None, None, 0),
    )
    if left is None or right is None:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED,
            "the calibration has no two projection matrices for a pair of image folders.",
            calib or folder,
        )
    pairs, skipped = pair(images(folder / left), images(folder / right), f"{left}/", f"{right}/", folder)
    names = [one.stem for one, _ in pairs]
    size = common_size([one for one, _ in pairs])
    missing: tuple[Diagnostic, ...] = ()
    rig, left_from_cam0 = uncalibrated(size), np.eye(4)
    if calib is None:
        missing = (calibration_missing("calib.txt (the projection matrices P0 to P3) is missing"),)
    else:
        stated = rectified_size(calib, size)
        rig, left_from_cam0 = projected_rig(
            projections[at], projections[at + 1], size, options, calib, stated
        )
    poses, up, lacking_poses = _poses(folder, options, left, names, calib)
    times = _times(folder, left, names)
    cam0_from_left = np.linalg.inv(left_from_cam0)
    frames = [
        Frame(
            name=one.stem,
            camera=rig.left,
            color=one,
            right=other,
            world_from_camera=None if pose is None else pose @ cam0_from_left,
            timestamp=time,
        )
        for (one, other), pose, time in zip(pairs, poses, times, strict=True)
    ]
    check_order(pairs, f"{left}/", f"{right}/")
    lacks = (*missing, *lacking_poses)
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=lacks, up=up)


def _read_views(folder: Path, options: ReadingParams, calib: Path) -> Scan:
    """Read a sequence of only one camera as single views."""
    projections = read_projections(calib)
    alone = _alone(folder, projections)
    if alone is None:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED, "the calibration has no projection matrix for an image folder.", calib
        )
    place, number = alone
    colors = images(folder / place)
    names = [color.stem for color in colors]
    size = common_size(colors)
    camera, camera_from_cam0 = projected_camera(
        projections[number], size, options, calib, rectified_size(calib, size)
    )
    poses, up, lacks = _poses(folder, options, place, names, calib)
    cam0_from_camera = np.linalg.inv(camera_from_cam0)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for color, pose, time in zip(colors, poses, _times(folder, place, names), strict=True):
        try:
            view = single_view(color.stem, camera, color, None if pose is None else pose @ cam0_from_camera)
        except InputError as error:
            skipped.append(SkippedFrame(color.stem, error.diagnostic))
            continue
        frames.append(replace(view, timestamp=time))
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=lacks, up=up)


def _poses(
    folder: Path, options: ReadingParams, place: str, names: list[str], calib: Path | None
) -> tuple[list[Pose | None], WorldUp | None, tuple[Diagnostic, ...]]:
    """Return world_from_cam0 of each frame, the up direction, and missing-pose diagnostics."""
    poses: list[Pose | None] = [None] * len(names)
    path = options.file("poses", folder) or _pose_file(folder)
    if path is not None:
        # In trajectory files, the first camera is the world frame, so the up direction is unknown.
        return trajectories.match(trajectories.read_trajectory(path), names, path), None, ()
    if place.endswith("/data") and calib is not None:
        found, reason = unit_poses(folder, names, calib)
        if found is not None:
            return found, up_of_layout(LAYOUT.name, Z_UP), ()
        remedy = "name a trajectory of camera 0 with scan.poses=FILE"
        return poses, None, (poses_missing("{reason}", remedy=remedy, reason=reason),)
    lacking = poses_missing(
        "poses.txt (or ../../poses/{name}.txt) is missing",
        remedy="name a trajectory with scan.poses=FILE",
        name=folder.resolve().name,
    )
    return poses, None, (lacking,)


def _times(folder: Path, left: str, names: list[str]) -> list[int | None]:
    """Read the timestamp of each frame, nanoseconds.

    From times.txt (seconds), or from timestamps.txt (dates) of raw recordings.
    """
    dates = folder / Path(left).parent / "timestamps.txt"
    if left.endswith("/data") and dates.exists():
        moments = [_nanoseconds(text, number, dates) for number, text in documents.lines(dates)]
        return list(trajectories.by_number(moments, names, dates, "times"))
    return trajectories.read_times(folder / "times.txt", names)


def _nanoseconds(text: str, number: int, path: Path) -> int:
    """Parse a line such as `2011-09-26 13:02:25.964389445` into nanoseconds."""
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=timezone.utc)
        return int(moment.timestamp()) * 10**9 + int(fraction[:9].ljust(9, "0"))
    except ValueError as error:
        raise InputError(
            SCAN_TABLE_DAMAGED, "line {number} is not a date and time.", path, number=number
        ) from error


def _pose_file(folder: Path) -> Path | None:
    """Return the trajectory file, or None.

    Candidates are poses.txt of the sequence and poses/NN.txt of the data set.
    """
    number = folder.resolve().name
    return first_existing(
        folder,
        "poses.txt",
        f"poses/{number}.txt",
        f"{number}.txt",
        f"../poses/{number}.txt",
        f"../../poses/{number}.txt",
    )


LAYOUT = Layout(
    name="kitti",
    text="image_0/ image_1/ (or image_2/ image_3/, raw: image_02/data/ image_03/data/), calib.txt, poses.txt "
    "(KITTI odometry)",
    matches=_matches,
    read=_read,
)
