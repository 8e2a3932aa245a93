"""Assignment of trajectory poses to frames, by timestamp or by order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import POSE_TRAJECTORY_UNREADABLE, RECORDING_CLOCKS_DIFFER
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Pose
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.trajectory.trajectory_formats import Trajectory


def match_poses_by_time(
    path: Path,
    timestamps: Sequence[int],
    names: Sequence[str],
    tolerance: int,
    options: ReadingParams,
    read: Callable[[Path], Trajectory] = trajectories.read_trajectory,
) -> list[Pose | None]:
    """Read a trajectory and return the pose of each frame.

    Returns None where no pose is near in time.

    With `poses_by_order`, poses are assigned by order instead of by time.

    Parameters
    ----------
    path : trajectory file.
    timestamps : timestamps of the frames, nanoseconds.
    names : names of the frames.
    tolerance : maximum time between frame and pose, nanoseconds.
    read : reader of the file format.

    Raises
    ------
    InputError
        If the file cannot be read, its poses have no timestamps, or no pose is near a frame.
    """
    trajectory = read(path)
    if options.poses_by_order:
        return trajectories.match_poses_to_frames(trajectory, names, path)
    if trajectory.timestamps is None:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            (
                "its poses have no timestamps, so they cannot be matched to frames by time; "
                "scan.poses_by_order=true assigns them in order."
            ),
            path,
        )
    if not len(trajectory):
        raise InputError(POSE_TRAJECTORY_UNREADABLE, "the trajectory file holds no poses.", path)
    ordered = trajectories.sort_by_time(trajectory)
    poses = [trajectories.interpolate_pose(ordered, moment, tolerance) for moment in timestamps]
    if timestamps and all(pose is None for pose in poses):
        times = trajectory.timestamps.tolist()
        start, end = (end / 1e9 for end in (min(times), max(times)))
        first, last = (end / 1e9 for end in (min(timestamps), max(timestamps)))
        offered = " There are as many poses as frames: scan.poses_by_order=true assigns them in order."
        raise InputError(
            RECORDING_CLOCKS_DIFFER,
            (
                "none of its {times_count} poses is within {tolerance:g} s of a frame: the poses "
                "cover {start:.3f} to {end:.3f} s, the frames {first:.3f} to {last:.3f} s.{offered}"
            ),
            path,
            times_count=len(times),
            tolerance=tolerance / 1000000000.0,
            start=start,
            end=end,
            first=first,
            last=last,
            offered=offered if len(times) == len(timestamps) else "",
        )
    return poses
