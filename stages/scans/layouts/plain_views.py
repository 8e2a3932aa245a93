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
from scanloom.stages.files.noting import note, only_looking
from scanloom.stages.scans.calibration.discovery import texts_of_poses
from scanloom.stages.scans.calibration.resolution import found_camera, stated_camera
from scanloom.stages.scans.codes import FRAME_POSE_MISSING, POSE_ASSUMED, SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import COLOR_FOLDERS, common_size, images
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.views import single_view
from scanloom.stages.scans.model.lacking import calibration_missing, poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import files as trajectories
from scanloom.stages.scans.trajectory.timed_poses import poses_at

# The last four names are from stereo layouts with only one camera present.
_FOLDERS = (*COLOR_FOLDERS, "photos", "frames", "imgs", "image_0", "image_2", "image_l", "image_left", "left")
# Two views are the minimum for depth estimation.
_LEAST_VIEWS = 2
# Names that are timestamps: seconds, or nanoseconds since 1970.
_SECONDS, _NANOSECONDS = re.compile(r"\d+\.\d+"), re.compile(r"\d{16,19}")
_TOLERANCE = 20_000_000
# Minimum ratio of photos that need a pose in a file for it to be the trajectory.
_POSED = 0.5


def _matches(folder: Path) -> str | None:
    place = place_of_photos(folder)
    if place is None:
        return None
    with only_looking():
        found = _trajectories(folder, images(place), ReadingParams())
    if not found:
        return None
    shown = f"{place.name}/" if place != folder else "images"
    return f"{shown} and {found[0].name}, one pose per image"


def place_of_photos(folder: Path) -> Path | None:
    """Return the folder that contains the photos, or None."""
    places = [folder / name for name in _FOLDERS if (folder / name).is_dir()]
    return next((place for place in (*places, folder) if len(images(place)) >= _LEAST_VIEWS), None)


def _trajectories(folder: Path, colors: Sequence[Path], options: ReadingParams) -> list[Path]:
    """Return the files of a folder that have poses for most photos."""
    found = []
    for path in texts_of_poses(folder):
        try:
            with collecting(forward=False):
                poses = _poses_of(path, colors, options)
        except InputError:
            continue
        if sum(pose is not None for pose in poses) >= max(_POSED * len(colors), _LEAST_VIEWS):
            found.append(path)
    return found


def _poses_of(path: Path, colors: Sequence[Path], options: ReadingParams) -> list[Pose | None]:
    names = [color.stem for color in colors]
    trajectory = trajectories.read_trajectory(path)
    moments = _moments(names, path)
    if trajectory.timestamps is None or moments is None:
        return trajectories.match(trajectory, names, path)
    return poses_at(path, moments, names, _TOLERANCE, options)


def _moments(names: Sequence[str], path: Path) -> list[int] | None:
    """Return the timestamps (ns) that images are named by, or None."""
    if all(_SECONDS.fullmatch(name) for name in names):
        return [trajectories.stamp(name, path, 0) for name in names]
    return [int(name) for name in names] if all(_NANOSECONDS.fullmatch(name) for name in names) else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    place = place_of_photos(folder)
    if place is None:
        raise InputError(SCAN_FILES_MISSING, "a folder images/ with at least two photos is required.", folder)
    colors = images(place)
    camera, is_known = _camera(folder, options, colors)
    path, poses = _poses(folder, options, colors)
    missing = []
    if not is_known:
        missing.append(
            calibration_missing(
                "no file in the scan folder states the camera",
                remedy="name a calibration with scan.calibration=FILE, or set scan.intrinsics=fx,fy,cx,cy",
            )
        )
    if path is None:
        missing.append(
            poses_missing(
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
            frames.append(single_view(color.stem, camera, color, pose))
        except InputError as error:
            skipped.append(SkippedFrame(color.stem, error.diagnostic))
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=tuple(missing), is_metric=True)


def _camera(folder: Path, options: ReadingParams, colors: Sequence[Path]) -> tuple[Camera, bool]:
    """Return the camera of the images, and True if it is known.

    False means that the camera is only a guess.
    """
    size = common_size(colors)
    stated = stated_camera(options, folder, *size)
    if stated is not None:
        return stated, True
    with collecting(forward=False) as diagnostics:
        camera, path = found_camera(folder, *size)
    # A guessed camera is not used; the calibration is reported as missing instead.
    if path is not None:
        emit(*diagnostics)
    return camera, path is not None


def _poses(
    folder: Path, options: ReadingParams, colors: Sequence[Path]
) -> tuple[Path | None, list[Pose | None]]:
    """Return the trajectory file (or None), and the pose of each image."""
    given = options.file("poses", folder)
    if given is not None:
        return given, _poses_of(given, colors, options)
    with only_looking():
        found = _trajectories(folder, colors, options)
    nothing: list[Pose | None] = [None] * len(colors)
    if not found:
        return None, nothing
    if len(found) > 1:
        emit(
            POSE_ASSUMED.warning(
                "several files have poses for the images: {files}. None is used",
                files=", ".join(path.name for path in found[:5]),
            )
        )
        return None, nothing
    path = found[0]
    note(path)
    emit(
        POSE_ASSUMED.warning(
            "the poses are read from {file}, which was found in the scan folder; they are assumed to "
            "be camera-to-world in metres",
            file=path.name,
        )
    )
    return path, _poses_of(path, colors, options)


LAYOUT = Layout(
    name="plain-views",
    text="images/ (or rgb/, photos/ and so on), a file with a pose per photo and a camera file, "
    "under any name: views without depth",
    matches=_matches,
    read=_read,
)
