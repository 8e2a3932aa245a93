"""Photos with camera and pose files of any name, without depth.

    images/frame_000319.png  …            or rgb/, color/ and so on, or in the scan folder itself
    poses.json | poses.txt | …            one camera-to-world pose per photo, by name, number, time or order
    intrinsic.json | K.txt | …            the camera of all photos

Files are recognised by their content. Poses are assumed to be in metres, for a camera with x right and
y down.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.file_access_log import pause_recording, record_opened
from scanloom.stages.scans.calibration.camera_resolution import find_or_guess_camera, get_stated_camera
from scanloom.stages.scans.calibration.discovery import list_trajectory_candidates
from scanloom.stages.scans.codes import FRAME_POSE_MISSING, POSE_ASSUMED, SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import COLOR_FOLDERS, find_common_size, list_images
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.posed_views import create_view_frame
from scanloom.stages.scans.model.missing_data import describe_missing_calibration, describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.trajectory.timed_poses import match_poses_by_time

# The last four names are from stereo layouts with only one camera present.
_PHOTO_FOLDERS = (
    *COLOR_FOLDERS,
    "photos",
    "frames",
    "imgs",
    "image_0",
    "image_2",
    "image_l",
    "image_left",
    "left",
)
# Two views are the minimum for depth estimation.
_MIN_VIEW_COUNT = 2
# Names that are timestamps: seconds, or nanoseconds since 1970.
_SECONDS_NAME, _NANOSECONDS_NAME = re.compile(r"\d+\.\d+"), re.compile(r"\d{16,19}")
_POSE_TOLERANCE_NS = 20_000_000
# Minimum ratio of photos that need a pose in a file for it to be the trajectory.
_MIN_POSED_RATIO = 0.5


def _matches(folder: Path) -> str | None:
    photo_folder = find_photo_folder(folder)
    if photo_folder is None:
        return None
    with pause_recording():
        found = _find_trajectories(folder, list_images(photo_folder), ReadingParams())
    if not found:
        return None
    photos = f"{photo_folder.name}/" if photo_folder != folder else "images"
    return f"{photos} and {found[0].name}, one pose per image"


def find_photo_folder(folder: Path) -> Path | None:
    """Return the folder that contains the photos, or None."""
    places = [folder / name for name in _PHOTO_FOLDERS if (folder / name).is_dir()]
    return next((place for place in (*places, folder) if len(list_images(place)) >= _MIN_VIEW_COUNT), None)


def _find_trajectories(folder: Path, colors: Sequence[Path], options: ReadingParams) -> list[Path]:
    """Return the files of a folder that have poses for most photos."""
    found = []
    for path in list_trajectory_candidates(folder):
        try:
            with collecting(forward=False):
                poses = _match_poses(path, colors, options)
        except InputError:
            continue
        if sum(pose is not None for pose in poses) >= max(_MIN_POSED_RATIO * len(colors), _MIN_VIEW_COUNT):
            found.append(path)
    return found


def _match_poses(path: Path, colors: Sequence[Path], options: ReadingParams) -> list[Pose | None]:
    names = [color.stem for color in colors]
    trajectory = trajectories.read_trajectory(path)
    moments = _parse_timestamps(names, path)
    if trajectory.timestamps is None or moments is None:
        return trajectories.match_poses_to_frames(trajectory, names, path)
    return match_poses_by_time(path, moments, names, _POSE_TOLERANCE_NS, options)


def _parse_timestamps(names: Sequence[str], path: Path) -> list[int] | None:
    """Return the timestamps (ns) that images are named by, or None."""
    if all(_SECONDS_NAME.fullmatch(name) for name in names):
        return [trajectories.parse_timestamp(name, path, 0) for name in names]
    return [int(name) for name in names] if all(_NANOSECONDS_NAME.fullmatch(name) for name in names) else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    photo_folder = find_photo_folder(folder)
    if photo_folder is None:
        raise InputError(SCAN_FILES_MISSING, "a folder images/ with at least two photos is required.", folder)
    colors = list_images(photo_folder)
    camera, is_known = _find_camera(folder, options, colors)
    path, poses = _find_poses(folder, options, colors)
    missing = []
    if not is_known:
        missing.append(
            describe_missing_calibration(
                "no file in the scan folder states the camera",
                remedy="name a calibration with scan.calibration=FILE, or set scan.intrinsics=fx,fy,cx,cy",
            )
        )
    if path is None:
        missing.append(
            describe_missing_poses(
                "no file in the scan folder has a pose for each photo",
                remedy="name a trajectory with scan.poses=FILE. Photos without poses need COLMAP; its "
                "workspace folder can be read directly",
            )
        )
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for color, pose in zip(colors, poses, strict=True):
        if path is not None and pose is None:
            reason = FRAME_POSE_MISSING.warning("{file} has no pose for it", file=path.name)
            skipped.append(SkippedFrame(color.stem, reason))
            continue
        try:
            frames.append(create_view_frame(color.stem, camera, color, pose))
        except InputError as error:
            skipped.append(SkippedFrame(color.stem, error.diagnostic))
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=tuple(missing), is_metric=True)


def _find_camera(folder: Path, options: ReadingParams, colors: Sequence[Path]) -> tuple[Camera, bool]:
    """Return the camera of the images, and True if it is known.

    False means that the camera is only a guess.
    """
    size = find_common_size(colors)
    stated = get_stated_camera(options, folder, *size)
    if stated is not None:
        return stated, True
    with collecting(forward=False) as diagnostics:
        camera, path = find_or_guess_camera(folder, *size)
    # A guessed camera is not used; the calibration is reported as missing instead.
    if path is not None:
        emit(*diagnostics)
    return camera, path is not None


def _find_poses(
    folder: Path, options: ReadingParams, colors: Sequence[Path]
) -> tuple[Path | None, list[Pose | None]]:
    """Return the trajectory file (or None), and the pose of each image."""
    given = options.resolve_file("poses", folder)
    if given is not None:
        return given, _match_poses(given, colors, options)
    with pause_recording():
        found = _find_trajectories(folder, colors, options)
    no_poses: list[Pose | None] = [None] * len(colors)
    if not found:
        return None, no_poses
    if len(found) > 1:
        emit(
            POSE_ASSUMED.warning(
                "several files have poses for the images: {files}. None is used",
                files=", ".join(path.name for path in found[:5]),
            )
        )
        return None, no_poses
    path = found[0]
    record_opened(path)
    emit(
        POSE_ASSUMED.warning(
            "the poses are read from {file}, which was found in the scan folder; they are assumed to "
            "be camera-to-world in metres",
            file=path.name,
        )
    )
    return path, _match_poses(path, colors, options)


LAYOUT = Layout(
    name="plain-views",
    description="images/ (or rgb/, photos/ and so on), a file with a pose per photo and a camera file, "
    "under any name: views without depth",
    matches=_matches,
    read=_read,
)
