"""TUM RGB-D: colour and depth streams with separate clocks, motion capture trajectory."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.discovery import find_trajectory
from scanloom.stages.scans.codes import (
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    POSE_ASSUMED,
    SCALE_DEPTH_UNIT_ASSUMED,
    SCAN_ASSUMED,
    SCAN_FILES_MISSING,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.depth_units import MM_UNITS_PER_METRE, infer_depth_scale
from scanloom.stages.scans.image_folders.image_files import (
    COLOR_FOLDERS,
    DEPTH_FOLDERS,
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    find_common_size,
    find_first_existing,
    has_all,
    list_images,
)
from scanloom.stages.scans.image_folders.path_remapping import find_listed_file
from scanloom.stages.scans.image_folders.timestamp_matching import match_timestamps
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.posed_views import create_view_frame
from scanloom.stages.scans.layouts.tum.associations import read_associations
from scanloom.stages.scans.layouts.tum.cameras import find_tum_camera, identify_camera, is_data_set_list
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.world import Z_UP, WorldUp, create_layout_up
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.trajectory.timed_poses import match_poses_by_time

# Nanoseconds; the tolerance of the data set's tools, less than a frame at 30 Hz.
_TOLERANCE_NS = 20_000_000
_SECOND_NS = 1_000_000_000
_UNITS_PER_METRE = 5000.0
_ASSOCIATION_FILES = ("associations.txt", "associate.txt", "association.txt", "associated.txt")
# Names of images (seconds) if the lists are lost.
_STAMPED_NAME = re.compile(r"\d+\.\d+")


@dataclass(frozen=True)
class _ListedImages:
    """Timestamps (n,) in nanoseconds and files of a stream, in list order."""

    times: NDArray[np.int64]
    files: list[Path]


def _matches(folder: Path) -> str | None:
    if has_all(folder, "rgb.txt", "depth.txt"):
        found = "rgb.txt and depth.txt"
    elif has_all(folder, "rgb") and (listed := find_first_existing(folder, *_ASSOCIATION_FILES)) is not None:
        found = f"rgb/ and {listed.name}"
    elif (stamped := _find_stamped_streams(folder)) is not None:
        color, depth = (stream.files[0].parent.name for stream in stamped)
        found = f"{color}/ and {depth}/ with timestamps as names"
    elif _is_without_depth(folder):
        found = "rgb.txt"
    else:
        return None
    return found + (" with groundtruth.txt" if has_all(folder, "groundtruth.txt") else "")


def _is_without_depth(folder: Path) -> bool:
    """Return True if a folder lists colour but has no depth."""
    return has_all(folder, "rgb.txt") and find_first_existing(folder, "depth.txt", *DEPTH_FOLDERS) is None


def _read(folder: Path, options: ReadingParams) -> Scan:
    if _is_without_depth(folder):
        return _read_views(folder, options)
    color_stream, depth_stream = _read_streams(folder)
    colors, depths = color_stream.files, depth_stream.files
    camera, calib = find_tum_camera(folder, options, *find_common_size(depths))
    scale = _resolve_depth_scale(folder, options, depths, calib)

    frames: list[Frame] = []
    partners = match_timestamps(color_stream.times, depth_stream.times, _TOLERANCE_NS).tolist()
    skipped = [
        SkippedFrame(color.stem, FRAME_IMAGE_MISSING.warning("no depth map within 0.02 s"))
        for color, partner in zip(colors, partners, strict=True)
        if partner < 0
    ]
    paired = [number for number, partner in enumerate(partners) if partner >= 0]
    # Poses are interpolated at the depth timestamps, because depth defines the surface.
    moments = [int(depth_stream.times[partners[number]]) for number in paired]
    names = [colors[number].stem for number in paired]
    path, poses = _find_poses(folder, moments, names, options)
    for number, pose in zip(paired, poses, strict=True):
        color, partner, time = colors[number], partners[number], int(color_stream.times[number])
        if pose is None and path is not None:
            skipped.append(
                SkippedFrame(
                    color.stem, FRAME_POSE_MISSING.warning("the trajectory has no pose within 0.02 s")
                )
            )
            continue
        frames.append(
            Frame(
                name=color.stem,
                camera=camera,
                color=color,
                depth=depths[partner],
                depth_scale=scale,
                world_from_camera=pose,
                timestamp=time,
            )
        )
    missing = _report_missing_poses(path)
    up = None if path is None else _find_up(folder, path)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing, up=up)


def _read_views(folder: Path, options: ReadingParams) -> Scan:
    """Read a recording without depth as single views."""
    stream = _read_list(folder / "rgb.txt")
    colors = _remap_files(stream.files, folder)
    camera, _ = find_tum_camera(folder, options, *find_common_size(colors))
    moments, names = stream.times.tolist(), [color.stem for color in colors]
    path, poses = _find_poses(folder, moments, names, options)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for color, time, pose in zip(colors, moments, poses, strict=True):
        if pose is None and path is not None:
            skipped.append(
                SkippedFrame(
                    color.stem, FRAME_POSE_MISSING.warning("the trajectory has no pose within 0.02 s")
                )
            )
            continue
        try:
            frames.append(replace(create_view_frame(color.stem, camera, color, pose), timestamp=time))
        except InputError as error:
            skipped.append(SkippedFrame(color.stem, error.diagnostic))
    missing = _report_missing_poses(path)
    up = None if path is None else _find_up(folder, path)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing, up=up)


def _find_poses(
    folder: Path, moments: Sequence[int], names: Sequence[str], options: ReadingParams
) -> tuple[Path | None, list[Pose | None]]:
    """Return the trajectory file (or None), and the pose at each timestamp."""
    path = options.resolve_file("poses", folder) or find_first_existing(folder, "groundtruth.txt")
    if path is not None:
        return path, match_poses_by_time(path, moments, names, _TOLERANCE_NS, options)
    return _find_unnamed_poses(folder, moments, names, options) or (None, [None] * len(names))


def _report_missing_poses(poses: Path | None) -> tuple[Diagnostic, ...]:
    return (describe_missing_poses("groundtruth.txt is missing"),) if poses is None else ()


def _find_unnamed_poses(
    folder: Path, moments: Sequence[int], names: Sequence[str], options: ReadingParams
) -> tuple[Path, list[Pose | None]] | None:
    """Find poses in the only file with one pose per frame.

    Returns None if there is no such file, or its times do not match the frames. Frame times that merely
    count the frames (1 s steps) are ignored, and poses are assigned by order.
    """
    path = find_trajectory(folder, len(names))
    if path is None:
        return None
    found = POSE_ASSUMED.warning(
        "the poses are read from {file}, which was found in the scan folder", file=path.name
    )
    if set(np.diff(moments)) == {_SECOND_NS}:
        found = POSE_ASSUMED.warning(
            "the poses are read from {file}, which was found in the scan folder. The image timestamps "
            "only count frames, so poses are assigned by order",
            file=path.name,
        )
        options = replace(options, poses_by_order=True)
    try:
        poses = match_poses_by_time(path, moments, names, _TOLERANCE_NS, options)
    except InputError:
        return None
    emit(found)
    return path, poses


def _find_up(folder: Path, trajectory: Path) -> WorldUp | None:
    """Return the up direction of the data set's motion capture, or None.

    None for other recordings in TUM format.
    """
    is_own = identify_camera(folder)[0] is not None or is_data_set_list(trajectory)
    return create_layout_up(LAYOUT.name, Z_UP) if is_own else None


def _read_streams(folder: Path) -> tuple[_ListedImages, _ListedImages]:
    """Return the colour and the depth stream."""
    if has_all(folder, "rgb.txt", "depth.txt"):
        color, depth = (_read_list(folder / name) for name in ("rgb.txt", "depth.txt"))
    elif (listed := find_first_existing(folder, *_ASSOCIATION_FILES)) is not None:
        associations = read_associations(listed)
        color = _ListedImages(
            np.array([one.color_time for one in associations]), [one.color for one in associations]
        )
        depth = _ListedImages(
            np.array([one.depth_time for one in associations]), [one.depth for one in associations]
        )
    elif (stamped := _find_stamped_streams(folder)) is not None:
        emit(
            SCAN_ASSUMED.warning(
                "rgb.txt and depth.txt are missing: images are matched by the timestamps in their names"
            )
        )
        return stamped
    else:
        raise InputError(
            SCAN_FILES_MISSING,
            "rgb.txt and depth.txt, or images with timestamps as names, are required.",
            folder,
        )
    colors, depths = (_remap_files(stream.files, folder) for stream in (color, depth))
    return replace(color, files=colors), replace(depth, files=depths)


def _read_list(path: Path) -> _ListedImages:
    """Read a stream from lines `seconds file`."""
    times, files = [], []
    for number, text in documents.iterate_lines(path):
        words = re.split(r"[\s;]+|,(?=\s*[^\d\s])", text, maxsplit=1)
        if len(words) != 2:
            raise InputError(SCAN_TABLE_DAMAGED, "line {number} is not `seconds file`.", path, number=number)
        times.append(trajectories.parse_timestamp(words[0].rstrip(","), path, number))
        files.append(_resolve_listed_file(words[1].strip(" ,;"), path, number))
    if not files:
        raise InputError(SCAN_TABLE_DAMAGED, "the file lists no images.", path)
    return _ListedImages(np.array(times, np.int64), files)


def _resolve_listed_file(name: str, path: Path, number: int) -> Path:
    """Resolve a listed file; an absolute path is matched by its end.

    Absolute paths come from another computer.
    """
    if PurePosixPath(name).is_absolute() or PureWindowsPath(name).is_absolute():
        return find_listed_file(path.parent, name, f"line {number}: {name[:100]!r}", path)
    return path.parent / documents.require_inside(name, path, f"line {number}")


def _find_stamped_streams(folder: Path) -> tuple[_ListedImages, _ListedImages] | None:
    """Return colour and depth streams of images named by timestamp, or None."""
    streams = []
    for names, suffixes in ((COLOR_FOLDERS, IMAGE_SUFFIXES), (DEPTH_FOLDERS, DEPTH_SUFFIXES)):
        place = find_first_existing(folder, *names)
        files = list_images(place, suffixes) if place is not None and place.is_dir() else []
        if not files or not all(_STAMPED_NAME.fullmatch(path.stem) for path in files):
            return None
        times = [trajectories.parse_timestamp(path.stem, path, 1) for path in files]
        streams.append(_ListedImages(np.array(times, np.int64), files))
    return streams[0], streams[1]


def _remap_files(files: list[Path], folder: Path) -> list[Path]:
    """Return the files of a stream, remapped if their folder was renamed."""
    listed = files[0].parent
    if listed.exists():
        return files
    holders = [place for place in folder.iterdir() if any((place / path.name).is_file() for path in files)]
    if len(holders) != 1:
        return files
    found = holders[0]
    emit(
        SCAN_ASSUMED.warning(
            "the folder {listed}/ does not exist: the listed images are read from {found}/",
            listed=listed.name,
            found=found.name,
        )
    )
    return [found / path.name for path in files]


def _resolve_depth_scale(
    folder: Path, options: ReadingParams, depths: Sequence[Path], calib: Path | None
) -> float:
    """Return the depth units per metre.

    They are stated, known for the data set, or inferred from the values.
    """
    stated = None if calib is None else calibration.read_depth_scale(calib)
    scale = options.depth_scale or stated
    if scale is None and identify_camera(folder)[0] is not None:
        scale = _UNITS_PER_METRE
    return _infer_scale(depths) if scale is None else scale


def _infer_scale(depths: Sequence[Path]) -> float:
    """Infer the depth units per metre from the values, with a warning."""
    units = infer_depth_scale(depths)
    if units == MM_UNITS_PER_METRE:
        emit(
            SCALE_DEPTH_UNIT_ASSUMED.warning(
                "depth is assumed to be in millimetres: with TUM's {units:g} units per metre, half of it "
                "would be below the minimum range of a Kinect",
                remedy="if it is in TUM's unit, set scan.depth_scale={units:g}",
                units=_UNITS_PER_METRE,
            )
        )
    if units is None:
        emit(
            SCALE_DEPTH_UNIT_ASSUMED.warning(
                "depth is assumed to have TUM's {units:g} units per metre",
                remedy="if it is in millimetres, set scan.depth_scale=1000",
                units=_UNITS_PER_METRE,
            )
        )
        return _UNITS_PER_METRE
    return units


LAYOUT = Layout(
    name="tum",
    description="rgb.txt and depth.txt (or associations.txt, or images with timestamps as names), "
    "groundtruth.txt (TUM RGB-D)",
    matches=_matches,
    read=_read,
)
