"""ICL-NUIM in TUM format: a rendered room with y up.

Both its camera and its world have y up.

The published camera matrix therefore has a focal length of -480. Here y is flipped in the camera and in
the world; flipping only the camera would mirror the room.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.resolution import stated_camera
from scanloom.stages.scans.codes import FRAME_POSE_MISSING, SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import common_size
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.tum.associations import read_associations
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame, scaled
from scanloom.stages.scans.model.world import Y_DOWN
from scanloom.stages.scans.trajectory import files as trajectories
from scanloom.stages.scans.trajectory.files import Trajectory
from scanloom.stages.scans.trajectory.timed_poses import poses_at

_CAMERA = Camera(640, 480, 481.2, 480.0, 319.5, 239.5)
_UNITS_PER_METRE = 5000.0
_TOLERANCE = 20_000_000
_POSES = "*.gt.freiburg"
_Y_OVER = np.diag((1.0, -1.0, 1.0, 1.0))


def _matches(folder: Path) -> str | None:
    found = next((path.name for path in sorted(folder.glob(_POSES))), None)
    return f"associations.txt and {found}" if found and (folder / "associations.txt").is_file() else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    listed = read_associations(folder / "associations.txt")
    path = options.file("poses", folder) or _pose_file(folder)
    size = common_size([one.depth for one in listed])
    camera = stated_camera(options, folder, *size) or scaled(_CAMERA, *size)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    poses: list[Pose | None] = [None] * len(listed)
    if path is not None:
        # ICL-NUIM has frame numbers in the timestamp columns.
        moments, names = [one.depth_time for one in listed], [one.depth.stem for one in listed]
        poses = poses_at(path, moments, names, _TOLERANCE, options, _trajectory)
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
    missing = () if path is not None else (poses_missing("{file} is missing", file=_POSES),)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _pose_file(folder: Path) -> Path | None:
    found = sorted(folder.glob(_POSES))
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


def _trajectory(path: Path) -> Trajectory:
    """Read a trajectory, with y down.

    Only the trajectory of the data set needs flipping; others have y down already.
    """
    trajectory = trajectories.read_trajectory(path)
    if not path.match(_POSES):
        return trajectory
    poses = [None if pose is None else _Y_OVER @ pose @ _Y_OVER for pose in trajectory.poses]
    return Trajectory(poses, trajectory.timestamps)


LAYOUT = Layout(
    name="icl-nuim",
    text="associations.txt, rgb/, depth/, *.gt.freiburg (ICL-NUIM in TUM format)",
    matches=_matches,
    read=_read,
    up=Y_DOWN,
)
