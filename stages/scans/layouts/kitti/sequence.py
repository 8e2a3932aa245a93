"""KITTI odometry: rectified pairs in numbered folders, calib.txt, one pose per line.

Raw recordings have the same pairs in image_02/data/ and image_03/data/, calib_cam_to_cam.txt in the parent
folder, and poses of the car in oxts/. If only one camera is present, its images are single views.
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
from scanloom.stages.files.path_safety import resolve_path
from scanloom.stages.scans.codes import CAMERA_PAIR_UNCALIBRATED, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import (
    find_common_size,
    find_first_existing,
    has_all,
    list_images,
    match_by_number,
    warn_if_paired_by_position,
)
from scanloom.stages.scans.layouts.kitti.oxts import read_oxts_poses
from scanloom.stages.scans.layouts.kitti.projections import (
    create_projected_rig,
    decompose_projection,
    read_projections,
    resolve_rectified_size,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.posed_views import create_view_frame
from scanloom.stages.scans.model.missing_data import describe_missing_calibration, describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.world import Z_UP, WorldUp, create_layout_up
from scanloom.stages.scans.streams.stereo_rigs import create_uncalibrated_rig
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

# Left folder, right folder, number of the left projection matrix. Colour cameras are preferred.
_CAMERA_FOLDERS = (
    ("image_2", "image_3", 2),
    ("image_02/data", "image_03/data", 2),
    ("image_0", "image_1", 0),
    ("image_00/data", "image_01/data", 0),
    ("image_l", "image_r", 0),
)
# Raw recordings share one calibration between all drives of a day.
_CALIBRATION_FILES = ("calib.txt", "calib_cam_to_cam.txt", "../calib_cam_to_cam.txt")


def _matches(folder: Path) -> str | None:
    calib = find_first_existing(folder, *_CALIBRATION_FILES)
    for left, right, _ in _CAMERA_FOLDERS:
        if has_all(folder, left, right) and (left != "image_l" or has_all(folder, "calib.txt")):
            return f"{left}/ and {right}/" + (f" with {calib.name}" if calib else "")
    if calib is None:
        return None
    try:
        single_camera = _find_single_camera(folder, read_projections(calib))
    except InputError:
        # Other layouts also have files of this name.
        return None
    return None if single_camera is None else f"{single_camera[0]}/ with {calib.name}"


def _find_single_camera(folder: Path, projections: Collection[int]) -> tuple[str, int] | None:
    """Return the image folder and number of a single calibrated camera."""
    for left, right, at in _CAMERA_FOLDERS:
        for name, number in ((left, at), (right, at + 1)):
            if has_all(folder, name) and number in projections:
                return name, number
    return None


def _read(folder: Path, options: ReadingParams) -> Scan:
    calib = options.resolve_file("calibration", folder) or find_first_existing(folder, *_CALIBRATION_FILES)
    if calib is not None and not any(has_all(folder, *names[:2]) for names in _CAMERA_FOLDERS):
        return _read_views(folder, options, calib)
    projections = {} if calib is None else read_projections(calib)
    left, right, at = next(
        (
            names
            for names in _CAMERA_FOLDERS
            if has_all(folder, *names[:2])
            and (calib is None or {names[2], names[2] + 1} <= projections.keys())
        ),
        (None, None, 0),
    )
    if left is None or right is None:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED,
            "the calibration has no two projection matrices for a pair of image folders.",
            calib or folder,
        )
    pairs, skipped = match_by_number(
        list_images(folder / left), list_images(folder / right), f"{left}/", f"{right}/", folder
    )
    names = [one.stem for one, _ in pairs]
    size = find_common_size([one for one, _ in pairs])
    missing: tuple[Diagnostic, ...] = ()
    rig, left_from_cam0 = create_uncalibrated_rig(size), np.eye(4)
    if calib is None:
        missing = (describe_missing_calibration("calib.txt (the projection matrices P0 to P3) is missing"),)
    else:
        stated = resolve_rectified_size(calib, size)
        rig, left_from_cam0 = create_projected_rig(
            projections[at], projections[at + 1], size, options, calib, stated
        )
    poses, up, lacking_poses = _read_poses(folder, options, left, names, calib)
    times = _read_times(folder, left, names)
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
    warn_if_paired_by_position(pairs, f"{left}/", f"{right}/")
    lacks = (*missing, *lacking_poses)
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=lacks, up=up)


def _read_views(folder: Path, options: ReadingParams, calib: Path) -> Scan:
    """Read a sequence of only one camera as single views."""
    projections = read_projections(calib)
    single_camera = _find_single_camera(folder, projections)
    if single_camera is None:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED, "the calibration has no projection matrix for an image folder.", calib
        )
    image_folder, number = single_camera
    colors = list_images(folder / image_folder)
    names = [color.stem for color in colors]
    size = find_common_size(colors)
    camera, camera_from_cam0 = decompose_projection(
        projections[number], size, options, calib, resolve_rectified_size(calib, size)
    )
    poses, up, lacks = _read_poses(folder, options, image_folder, names, calib)
    cam0_from_camera = np.linalg.inv(camera_from_cam0)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for color, pose, time in zip(colors, poses, _read_times(folder, image_folder, names), strict=True):
        try:
            view = create_view_frame(
                color.stem, camera, color, None if pose is None else pose @ cam0_from_camera
            )
        except InputError as error:
            skipped.append(SkippedFrame(color.stem, error.diagnostic))
            continue
        frames.append(replace(view, timestamp=time))
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=lacks, up=up)


def _read_poses(
    folder: Path, options: ReadingParams, image_folder: str, names: list[str], calib: Path | None
) -> tuple[list[Pose | None], WorldUp | None, tuple[Diagnostic, ...]]:
    """Return world_from_cam0 of each frame, the up direction, and missing-pose diagnostics."""
    poses: list[Pose | None] = [None] * len(names)
    path = options.resolve_file("poses", folder) or _find_pose_file(folder)
    if path is not None:
        # In trajectory files, the first camera is the world frame, so the up direction is unknown.
        return trajectories.match_poses_to_frames(trajectories.read_trajectory(path), names, path), None, ()
    if image_folder.endswith("/data") and calib is not None:
        found, reason = read_oxts_poses(folder, names, calib)
        if found is not None:
            return found, create_layout_up(LAYOUT.name, Z_UP), ()
        remedy = "name a trajectory of camera 0 with scan.poses=FILE"
        return poses, None, (describe_missing_poses("{reason}", remedy=remedy, reason=reason),)
    lacking = describe_missing_poses(
        "poses.txt (or ../../poses/{name}.txt) is missing",
        remedy="name a trajectory with scan.poses=FILE",
        name=resolve_path(folder).name,
    )
    return poses, None, (lacking,)


def _read_times(folder: Path, left: str, names: list[str]) -> list[int | None]:
    """Read the timestamp of each frame, nanoseconds.

    From times.txt (seconds), or from timestamps.txt (dates) of raw recordings.
    """
    dates = folder / Path(left).parent / "timestamps.txt"
    if left.endswith("/data") and dates.exists():
        moments = [_parse_nanoseconds(text, number, dates) for number, text in documents.iterate_lines(dates)]
        return list(trajectories.assign_by_number(moments, names, dates, "times"))
    return trajectories.read_times(folder / "times.txt", names)


def _parse_nanoseconds(text: str, number: int, path: Path) -> int:
    """Parse a line such as `2011-09-26 13:02:25.964389445` into nanoseconds."""
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=timezone.utc)
        return int(moment.timestamp()) * 10**9 + int(fraction[:9].ljust(9, "0"))
    except ValueError as error:
        raise InputError(
            SCAN_TABLE_DAMAGED, "line {number} is not a date and time.", path, number=number
        ) from error


def _find_pose_file(folder: Path) -> Path | None:
    """Return the trajectory file, or None.

    Candidates are poses.txt of the sequence and poses/NN.txt of the data set.
    """
    number = resolve_path(folder).name
    return find_first_existing(
        folder,
        "poses.txt",
        f"poses/{number}.txt",
        f"{number}.txt",
        f"../poses/{number}.txt",
        f"../../poses/{number}.txt",
    )


LAYOUT = Layout(
    name="kitti",
    description="image_0/ image_1/ (or image_2/ image_3/, raw: image_02/data/ image_03/data/), calib.txt, "
    "poses.txt "
    "(KITTI odometry)",
    matches=_matches,
    read=_read,
)
