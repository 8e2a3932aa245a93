"""Poses in one file per frame.

A frame with a damaged file is skipped; many damaged files are an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import POSE_INVALID
from scanloom.stages.scans.model.scan import Pose, SkippedFrame
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

# Maximum ratio of damaged files; with more, the file format is probably a different one.
_MAX_DAMAGED_RATIO = 0.1


def read_pose_files(files: Mapping[str, Path]) -> tuple[dict[str, Pose | None], list[SkippedFrame]]:
    """Read one pose per frame, and collect the frames with damaged files.

    Parameters
    ----------
    files : existing files by frame name.

    Returns
    -------
    (4, 4) poses by frame name, None where tracking was lost; and the frames with damaged files.

    Raises
    ------
    InputError
        The first error, if more than a tenth of the files are damaged.
    """
    read = {name: _try_read_pose(path) for name, path in files.items()}
    poses = {name: pose for name, pose in read.items() if not isinstance(pose, InputError)}
    faults = {name: fault for name, fault in read.items() if isinstance(fault, InputError)}
    if len(faults) > _MAX_DAMAGED_RATIO * len(files):
        raise next(iter(faults.values()))
    return poses, [
        SkippedFrame(name, POSE_INVALID.warning("its pose is damaged: {reason}", reason=str(error)))
        for name, error in faults.items()
    ]


def _try_read_pose(path: Path) -> Pose | InputError | None:
    try:
        return trajectories.read_pose(path)
    except InputError as error:
        return error
