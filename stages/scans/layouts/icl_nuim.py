"""ICL-NUIM in TUM format: a rendered room with y up.

Both its camera and its world have y up.

The published camera matrix therefore has a focal length of -480. Here y is flipped in the camera and in
the world; flipping only the camera would mirror the room.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import FRAME_POSE_MISSING, SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import find_common_size
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.tum.associations import read_associations
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame, scale_camera
from scanloom.stages.scans.model.world import Y_DOWN
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.trajectory.timed_poses import match_poses_by_time
from scanloom.stages.scans.trajectory.trajectory_formats import Trajectory

_CAMERA = Camera(640, 480, 481.2, 480.0, 319.5, 239.5)
_UNITS_PER_METRE = 5000.0
_POSE_TOLERANCE_NS = 20_000_000
_POSE_PATTERN = "*.gt.freiburg"
_FLIP_Y = np.diag((1.0, -1.0, 1.0, 1.0))


def _matches(folder: Path) -> str | None:
    found = next((path.name for path in sorted(folder.glob(_POSE_PATTERN))), None)
    return f"associations.txt and {found}" if found and (folder / "associations.txt").is_file() else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    listed = read_associations(folder / "associations.txt")
    path = options.resolve_file("poses", folder) or _find_pose_file(folder)
    size = find_common_size([one.depth for one in listed])
    camera = get_stated_camera(options, folder, *size) or scale_camera(_CAMERA, *size)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    poses: list[Pose | None] = [None] * len(listed)
    if path is not None:
        # ICL-NUIM has frame numbers in the timestamp columns.
        moments, names = [one.depth_time for one in listed], [one.depth.stem for one in listed]
        poses = match_poses_by_time(path, moments, names, _POSE_TOLERANCE_NS, options, _read_trajectory)
    for one, pose in zip(listed, poses, strict=True):
        if pose is None and path is not None:
            skipped.append(
                SkippedFrame(
                    one.depth.stem, FRAME_POSE_MISSING.warning("the trajectory has no pose with its number")
                )
            )
            continue
        frames.append(
            Frame(
                name=one.depth.stem,
                camera=camera,
                color=one.color,
                depth=one.depth,
                depth_scale=options.depth_scale or _UNITS_PER_METRE,
                world_from_camera=pose,
            )
        )
    missing = () if path is not None else (describe_missing_poses("{file} is missing", file=_POSE_PATTERN),)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _find_pose_file(folder: Path) -> Path | None:
    found = sorted(folder.glob(_POSE_PATTERN))
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise InputError(
            SCAN_FILES_MISSING,
            "the folder has several trajectories ({names})",
            folder,
            remedy="choose one with scan.poses=FILE.",
            names=names,
        )
    return found[0] if found else None


def _read_trajectory(path: Path) -> Trajectory:
    """Read a trajectory, with y down.

    Only the trajectory of the data set needs flipping; others have y down already.
    """
    trajectory = trajectories.read_trajectory(path)
    if not path.match(_POSE_PATTERN):
        return trajectory
    poses = [None if pose is None else _FLIP_Y @ pose @ _FLIP_Y for pose in trajectory.poses]
    return Trajectory(poses, trajectory.timestamps)


LAYOUT = Layout(
    name="icl-nuim",
    description="associations.txt, rgb/, depth/, *.gt.freiburg (ICL-NUIM in TUM format)",
    matches=_matches,
    read=_read,
    up=Y_DOWN,
)
