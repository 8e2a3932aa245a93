"""scanloom's own stereo layout: left/, right/, a calibration, and left camera poses.

    left/000000.png  right/000000.png  …
    left01.png  right01.png  …                    both views in one folder; also 01_left.png, cam_L_01.png
    000000.png  …                                 side-by-side: both views in one image
    calibration.json | .toml | .yaml | .xml       see stages.scans.calibration.rig_calibration.read_rig
    poses.txt | poses.tum | trajectory.log | …    camera-to-world, one pose per pair

Timestamped poses (TUM format) are interpolated at the times in times.txt (seconds, one per pair) if it
exists.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.discovery import find_trajectory
from scanloom.stages.scans.codes import POSE_ASSUMED, SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import (
    extract_numbers,
    find_common_size,
    find_first_existing,
    has_all,
    list_images,
    match_by_number,
    warn_if_paired_by_position,
)
from scanloom.stages.scans.image_folders.side_by_side_stereo import is_side_by_side, split_halves
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.streams.stereo_rigs import find_rig
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.trajectory.timed_poses import match_poses_by_time

_SIDE_FOLDERS = (
    ("left", "right"),
    ("image_left", "image_right"),
    ("image_l", "image_r"),
    ("cam0", "cam1"),
    ("L", "R"),
)
# Matched in lower-case file names: the whole word anywhere, or its first letter as a separate token.
_SIDE_PATTERNS = tuple(re.compile(rf"{word}|(?<![a-z]){word[0]}(?![a-z])") for word in ("left", "right"))
# Folders that may hold both views.
_SIDE_BY_SIDE_FOLDERS = ("images", "image", "frames", "stereo", "sbs")
_ImagePair = tuple[Path, Path] | tuple[PackedImage, PackedImage]
# Images that are not photos of the scene, and images that the rig was calibrated with.
_NON_PHOTO_NAME = re.compile("disp|depth|mask|conf|seg|normal", re.IGNORECASE)
_BOARD_NAME = re.compile("calib|chess|board", re.IGNORECASE)
_CALIBRATION_FILES = tuple(
    f"{stem}.{suffix}"
    for stem in ("calibration", "calib", "stereo", "rig", "camchain")
    for suffix in ("json", "toml", "yaml", "yml", "xml")
)
_TRAJECTORY_FILES = (
    "poses.txt",
    "poses.tum",
    "trajectory.tum",
    "trajectory.log",
    "trajectory.txt",
    "poses.json",
    "trajectory.json",
)
_POSE_TOLERANCE_NS = 20_000_000


def _find_side_folders(folder: Path) -> tuple[str, str] | None:
    """Return the folders of the left and right images, or None.

    They have usual names, or are the only two whose names differ just in left/right.
    """
    usual = next((names for names in _SIDE_FOLDERS if has_all(folder, *names)), None)
    if usual is not None:
        return usual
    places = {path.name for path in folder.iterdir() if path.is_dir()}
    named = [
        (name, other)
        for name in sorted(places)
        for left, right in (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"))
        if left in name
        and (other := name.replace(left, right)) in places
        and not _NON_PHOTO_NAME.search(name)
    ]
    if len(named) > 1:
        named = [names for names in named if not _BOARD_NAME.search(names[0])]
    return named[0] if len(named) == 1 and all(list_images(folder / name) for name in named[0]) else None


def _list_sides_by_name(folder: Path) -> list[list[Path]]:
    """Return the left and right images of a folder, distinguished by name."""
    files = [
        path
        for path in list_images(folder)
        if extract_numbers(path.stem) and not _NON_PHOTO_NAME.search(path.stem)
    ]
    return [[path for path in files if side.search(path.stem.lower())] for side in _SIDE_PATTERNS]


def _matches(folder: Path) -> str | None:
    sides = _find_side_folders(folder)
    if sides is not None:
        return f"{sides[0]}/ and {sides[1]}/"
    left, right = _list_sides_by_name(folder)
    if left and right:
        return f"files named like {left[0].name} and {right[0].name}"
    side_by_side = _list_side_by_side_images(folder)
    return f"side-by-side images like {side_by_side[0].name}" if side_by_side else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    names, pairs, size, skipped = _find_pairs(folder)
    rig, missing = find_rig(folder, options, size, _CALIBRATION_FILES)
    times = trajectories.read_times(folder / "times.txt", names)
    path = options.resolve_file("poses", folder) or find_first_existing(folder, *_TRAJECTORY_FILES)
    if path is None and (path := find_trajectory(folder, len(pairs))) is not None:
        emit(
            POSE_ASSUMED.warning(
                "the poses are read from {file}, which was found in the scan folder", file=path.name
            )
        )
    poses: list[Pose | None]
    if path is not None:
        poses = _read_poses(path, names, times, options)
    else:
        poses = [None] * len(pairs)
        missing = (
            *missing,
            describe_missing_poses("the folder has none of {files}", files=", ".join(_TRAJECTORY_FILES)),
        )
    frames = [
        Frame(name=name, camera=rig.left, color=one, right=other, world_from_camera=pose, timestamp=time)
        for name, (one, other), pose, time in zip(names, pairs, poses, times, strict=True)
    ]
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=missing)


def _find_pairs(
    folder: Path,
) -> tuple[list[str], Sequence[_ImagePair], tuple[int, int], list[SkippedFrame]]:
    """Return pair names, pairs, image size (width, height), and skipped frames."""
    sides = _find_side_folders(folder)
    if sides is None:
        left, right = _list_sides_by_name(folder)
        named = "the images named left", "the images named right"
    else:
        left, right = (list_images(folder / name) for name in sides)
        named = f"{sides[0]}/", f"{sides[1]}/"
    if sides is None and not (left and right):
        if side_by_side := _list_side_by_side_images(folder):
            width, height = find_common_size(side_by_side)
            halves = [split_halves(path) for path in side_by_side]
            return [path.stem for path in side_by_side], halves, (width // 2, height), []
        raise InputError(
            SCAN_FILES_MISSING,
            "two folders left/ and right/, or images left01.png and right01.png, are required.",
            folder,
        )
    pairs, skipped = match_by_number(left, right, *named, folder)
    size = find_common_size([one for one, _ in pairs])
    warn_if_paired_by_position(pairs, *named)
    return [one.stem for one, _ in pairs], pairs, size, skipped


def _list_side_by_side_images(folder: Path) -> list[Path]:
    """List the side-by-side images of the folder or a subfolder."""
    places = (folder, *(folder / name for name in _SIDE_BY_SIDE_FOLDERS if (folder / name).is_dir()))
    return next((found for place in places if is_side_by_side(found := list_images(place))), [])


def _read_poses(
    path: Path, names: list[str], times: list[int | None], options: ReadingParams
) -> list[Pose | None]:
    trajectory = trajectories.read_trajectory(path)
    moments = [time for time in times if time is not None]
    if trajectory.timestamps is None or len(moments) < len(names):
        return trajectories.match_poses_to_frames(trajectory, names, path)
    return match_poses_by_time(path, moments, names, _POSE_TOLERANCE_NS, options)


LAYOUT = Layout(
    name="plain-stereo",
    description="left/, right/ (or left01.png and right01.png in one folder), calibration.json|toml|yaml, "
    "poses.txt|tum|log|json (scanloom's own)",
    matches=_matches,
    read=_read,
)
