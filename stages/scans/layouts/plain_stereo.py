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
from scanloom.stages.scans.calibration.discovery import trajectory_beside
from scanloom.stages.scans.codes import POSE_ASSUMED, SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import (
    check_order,
    common_size,
    first_existing,
    has,
    images,
    numbers,
    pair,
)
from scanloom.stages.scans.image_folders.side_by_side_stereo import are_pairs, halves_of
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Packed, Pose, Scan, SkippedFrame
from scanloom.stages.scans.streams.stereo_rigs import rig_of
from scanloom.stages.scans.trajectory import files as trajectories
from scanloom.stages.scans.trajectory.timed_poses import poses_at

_SIDES = (
    ("left", "right"),
    ("image_left", "image_right"),
    ("image_l", "image_r"),
    ("cam0", "cam1"),
    ("L", "R"),
)
# Matched in lower-case file names: the whole word anywhere, or its first letter as a separate token.
_NAMED = tuple(re.compile(rf"{word}|(?<![a-z]){word[0]}(?![a-z])") for word in ("left", "right"))
# Folders that may hold both views.
_WHOLE = ("images", "image", "frames", "stereo", "sbs")
_Pair = tuple[Path, Path] | tuple[Packed, Packed]
# Images that are not photos of the scene, and images that the rig was calibrated with.
_NO_PHOTOS = re.compile("disp|depth|mask|conf|seg|normal", re.IGNORECASE)
_OF_BOARDS = re.compile("calib|chess|board", re.IGNORECASE)
_CALIBRATIONS = tuple(
    f"{stem}.{suffix}"
    for stem in ("calibration", "calib", "stereo", "rig", "camchain")
    for suffix in ("json", "toml", "yaml", "yml", "xml")
)
_TRAJECTORIES = (
    "poses.txt",
    "poses.tum",
    "trajectory.tum",
    "trajectory.log",
    "trajectory.txt",
    "poses.json",
    "trajectory.json",
)
_TOLERANCE = 20_000_000


def _sides(folder: Path) -> tuple[str, str] | None:
    """Return the folders of the left and right images, or None.

    They have usual names, or are the only two whose names differ just in left/right.
    """
    usual = next((names for names in _SIDES if has(folder, *names)), None)
    if usual is not None:
        return usual
    places = {path.name for path in folder.iterdir() if path.is_dir()}
    named = [
        (name, other)
        for name in sorted(places)
        for left, right in (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"))
        if left in name and (other := name.replace(left, right)) in places and not _NO_PHOTOS.search(name)
    ]
    if len(named) > 1:
        named = [names for names in named if not _OF_BOARDS.search(names[0])]
    return named[0] if len(named) == 1 and all(images(folder / name) for name in named[0]) else None


def _side_by_side(folder: Path) -> list[list[Path]]:
    """Return the left and right images of a folder, distinguished by name."""
    files = [path for path in images(folder) if numbers(path.stem) and not _NO_PHOTOS.search(path.stem)]
    return [[path for path in files if side.search(path.stem.lower())] for side in _NAMED]


def _matches(folder: Path) -> str | None:
    sides = _sides(folder)
    if sides is not None:
        return f"{sides[0]}/ and {sides[1]}/"
    left, right = _side_by_side(folder)
    if left and right:
        return f"files named like {left[0].name} and {right[0].name}"
    whole = _whole(folder)
    return f"side-by-side images like {whole[0].name}" if whole else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    names, pairs, size, skipped = _pairs(folder)
    rig, missing = rig_of(folder, options, size, _CALIBRATIONS)
    times = trajectories.read_times(folder / "times.txt", names)
    path = options.file("poses", folder) or first_existing(folder, *_TRAJECTORIES)
    if path is None and (path := trajectory_beside(folder, len(pairs))) is not None:
        emit(
            POSE_ASSUMED.warning(
                "the poses are read from {file}, which was found in the scan folder", file=path.name
            )
        )
    poses: list[Pose | None]
    if path is not None:
        poses = _poses(path, names, times, options)
    else:
        poses = [None] * len(pairs)
        missing = (*missing, poses_missing("the folder has none of {files}", files=", ".join(_TRAJECTORIES)))
    frames = [
        Frame(name=name, camera=rig.left, color=one, right=other, world_from_camera=pose, timestamp=time)
        for name, (one, other), pose, time in zip(names, pairs, poses, times, strict=True)
    ]
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=missing)


def _pairs(
    folder: Path,
) -> tuple[list[str], Sequence[_Pair], tuple[int, int], list[SkippedFrame]]:
    """Return pair names, pairs, image size (width, height), and skipped frames."""
    sides = _sides(folder)
    if sides is None:
        left, right = _side_by_side(folder)
        named = "the images named left", "the images named right"
    else:
        left, right = (images(folder / name) for name in sides)
        named = f"{sides[0]}/", f"{sides[1]}/"
    if sides is None and not (left and right):
        if whole := _whole(folder):
            width, height = common_size(whole)
            halves = [halves_of(path) for path in whole]
            return [path.stem for path in whole], halves, (width // 2, height), []
        raise InputError(
            SCAN_FILES_MISSING,
            "two folders left/ and right/, or images left01.png and right01.png, are required.",
            folder,
        )
    pairs, skipped = pair(left, right, *named, folder)
    size = common_size([one for one, _ in pairs])
    check_order(pairs, *named)
    return [one.stem for one, _ in pairs], pairs, size, skipped


def _whole(folder: Path) -> list[Path]:
    """Return the side-by-side images of the folder or a subfolder.

    Empty if there are none.
    """
    places = (folder, *(folder / name for name in _WHOLE if (folder / name).is_dir()))
    return next((found for place in places if are_pairs(found := images(place))), [])


def _poses(
    path: Path, names: list[str], times: list[int | None], options: ReadingParams
) -> list[Pose | None]:
    trajectory = trajectories.read_trajectory(path)
    moments = [time for time in times if time is not None]
    if trajectory.timestamps is None or len(moments) < len(names):
        return trajectories.match(trajectory, names, path)
    return poses_at(path, moments, names, _TOLERANCE, options)


LAYOUT = Layout(
    name="plain-stereo",
    text="left/, right/ (or left01.png and right01.png in one folder), calibration.json|toml|yaml, "
    "poses.txt|tum|log|json (scanloom's own)",
    matches=_matches,
    read=_read,
)
