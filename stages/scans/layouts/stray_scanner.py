"""Stray Scanner: a video, `odometry.csv`, and depth with confidence.

odometry.csv has one row per video frame; depth and confidence files are named by number.

Poses are camera-to-world, with OpenCV camera axes; the world has y up. The camera matrix is for the
video size. If the user gives other poses (`poses=FILE`), the up direction comes from the accelerometer
in `imu.csv`.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import (
    FRAME_IMAGE_MISSING,
    SCAN_FILES_MISSING,
    SCAN_IMAGES_UNPAIRED,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.image_files import (
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    extract_numbers,
    find_common_size,
    list_images,
)
from scanloom.stages.scans.layouts.shared.gravity import estimate_up_directions
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phone_imu import read_phone_accelerometer
from scanloom.stages.scans.layouts.shared.phone_scans import resolve_min_confidence, scale_to_size
from scanloom.stages.scans.layouts.shared.posed_views import create_depth_missing_error
from scanloom.stages.scans.model.poses import create_pose_from_quaternion
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.video import Video
from scanloom.stages.scans.model.world import Y_UP
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_CONFIDENCE_LEVELS = (0, 1, 2)
_POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
_INTRINSICS_COLUMNS = ("fx", "fy", "cx", "cy")


@dataclass(frozen=True, eq=False)
class _OdometryRow:
    """Row of odometry.csv; `frame_number` names the depth and confidence files."""

    frame_number: int
    pose: Pose | None
    timestamp: int | None
    intrinsics: tuple[float, float, float, float] | None


def _matches(folder: Path) -> str | None:
    found = all((folder / name).is_file() for name in ("odometry.csv", "camera_matrix.csv"))
    return "odometry.csv and camera_matrix.csv" if found else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    rows = _read_rows(folder / "odometry.csv")
    depths = _list_by_number(folder / "depth", DEPTH_SUFFIXES)
    confidences = _list_by_number(folder / "confidence", IMAGE_SUFFIXES)
    if not depths:
        raise create_depth_missing_error(folder, "Stray Scanner writes depth/ if the phone has a LiDAR.")
    if not (folder / "rgb.mp4").exists():
        raise InputError(
            SCAN_FILES_MISSING,
            "rgb.mp4 is missing; its size is needed to interpret camera_matrix.csv.",
            folder,
        )
    video = Video(folder / "rgb.mp4")
    stated = get_stated_camera(options, folder, video.width, video.height)
    shared = stated or calibration.read_camera(folder / "camera_matrix.csv", video.width, video.height)
    min_confidence = resolve_min_confidence(options, _CONFIDENCE_LEVELS, folder) if confidences else 0
    if video.frame_count and video.frame_count != len(rows):
        emit(
            SCAN_IMAGES_UNPAIRED.warning(
                "rgb.mp4 has {frame_count} frames but odometry.csv has {row_count} rows: they are paired "
                "from the beginning",
                frame_count=video.frame_count,
                row_count=len(rows),
            )
        )
    size = find_common_size(list(depths.values()))
    given = options.resolve_file("poses", folder)
    names = [f"{row.frame_number:06d}" for row in rows]
    poses = [row.pose for row in rows]
    if given is not None:
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)
    ups = _estimate_ups(folder / "imu.csv", rows)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for position, (row, name, pose) in enumerate(zip(rows, names, poses, strict=True)):
        if row.frame_number not in depths:
            skipped.append(SkippedFrame(name, FRAME_IMAGE_MISSING.warning("its depth map is missing")))
        elif video.frame_count and position >= video.frame_count:
            reason = FRAME_IMAGE_MISSING.warning("the video has only {count} frames", count=video.frame_count)
            skipped.append(SkippedFrame(name, reason))
        else:
            color_camera = stated or _get_frame_camera(row, shared, folder / "odometry.csv")
            frames.append(
                Frame(
                    name=name,
                    camera=scale_to_size(color_camera, size, "the depth maps", folder),
                    color=PackedImage(
                        video.path, f"frame {position}", functools.partial(video.read_frame, position)
                    ),
                    depth=depths[row.frame_number],
                    depth_scale=options.depth_scale or 1000.0,
                    world_from_camera=pose,
                    timestamp=row.timestamp,
                    color_camera=color_camera,
                    confidence=confidences.get(row.frame_number),
                    min_confidence=min_confidence,
                    # ARKit's poses are gravity-aligned, which is more accurate than the accelerometer.
                    up=ups[position] if given is not None or pose is None else None,
                )
            )
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped))


def _estimate_ups(path: Path, rows: Sequence[_OdometryRow]) -> list[NDArray[np.float64] | None]:
    """Return the up direction of the camera at each row, or None."""
    accelerometer = read_phone_accelerometer(path)
    times = [row.timestamp for row in rows if row.timestamp is not None]
    if len(times) < len(rows):
        return [None] * len(rows)
    return estimate_up_directions(accelerometer, np.array(times, np.int64))


def _list_by_number(folder: Path, suffixes: tuple[str, ...]) -> dict[int, Path]:
    files = list_images(folder, suffixes) if folder.is_dir() else []
    return {found[-1]: file for file in files if (found := extract_numbers(file.stem))}


def _read_rows(path: Path) -> list[_OdometryRow]:
    """Read odometry.csv by column name, because app versions have different columns."""
    lines = list(documents.iterate_lines(path))
    header = [name.strip().lower() for name in lines[0][1].split(",")] if lines else []
    if lacking := [name for name in _POSE_COLUMNS if name not in header]:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "the column {lacking} is missing in the first line.",
            path,
            lacking=", ".join(lacking),
        )
    rows: list[_OdometryRow] = []
    for number, text in lines[1:]:
        fields = text.split(",")
        try:
            row = {name: float(field) for name, field in zip(header, fields, strict=True)}
        except ValueError as error:
            raise InputError(
                SCAN_TABLE_DAMAGED,
                "line {number} does not have {header_count} numbers.",
                path,
                number=number,
                header_count=len(header),
            ) from error
        rows.append(_parse_row(row, len(rows), number, path))
    if not rows:
        raise InputError(SCAN_TABLE_DAMAGED, "the file has no poses.", path)
    return rows


def _parse_row(row: dict[str, float], position: int, line: int, path: Path) -> _OdometryRow:
    x, y, z, *quaternion = (row[name] for name in _POSE_COLUMNS)
    number = row.get("frame", position)
    if not 0 <= number < 1 << 31:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "line {line}: invalid frame number {number:g}.",
            path,
            line=line,
            number=number,
        )
    has_own = all(name in row for name in _INTRINSICS_COLUMNS)
    time = row.get("timestamp")
    return _OdometryRow(
        int(number),
        create_pose_from_quaternion((x, y, z), quaternion, path, f"line {line}"),
        None if time is None else trajectories.to_nanoseconds(time, path, line),
        (row["fx"], row["fy"], row["cx"], row["cy"]) if has_own else None,
    )


def _get_frame_camera(row: _OdometryRow, shared: Camera, path: Path) -> Camera:
    """Return the camera of a video frame, or the shared camera."""
    if row.intrinsics is None:
        return shared
    return calibration.check_camera_values(Camera(shared.width, shared.height, *row.intrinsics), path)


LAYOUT = Layout(
    name="stray-scanner",
    description="rgb.mp4, odometry.csv, camera_matrix.csv, depth/, confidence/, imu.csv (Stray Scanner)",
    matches=_matches,
    read=_read,
    up=Y_UP,
    is_gravity_aligned=True,
)
