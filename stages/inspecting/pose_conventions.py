"""Candidate pose conventions: direction, axes and frame order."""

from __future__ import annotations

from collections.abc import Sequence

from scanloom.stages.scans.model.poses import (
    AS_WRITTEN,
    WORLD_TO_CAMERA,
    WORLD_TO_CAMERA_Y_UP,
    Y_UP,
    invert_pose,
    to_camera_to_world,
)
from scanloom.stages.scans.model.scan import Pose

AS_GIVEN = "as given"
# Values of `scan.pose_convention`, by their description in messages.
_CONVENTION_BY_DESCRIPTION = {
    AS_GIVEN: AS_WRITTEN,
    WORLD_TO_CAMERA: WORLD_TO_CAMERA,
    "in camera axes with y up and z back": Y_UP,
    "world-to-camera in axes with y up and z back": WORLD_TO_CAMERA_Y_UP,
}


def suggest_pose_convention(best: str) -> str:
    """Suggest how to correct the pose convention, as a sentence.

    Parameters
    ----------
    best : description of the best-fitting convention, a key of `compute_relative_poses`.
    """
    convention = _CONVENTION_BY_DESCRIPTION.get(best)
    change = "Provide" if convention is None else f"Set scan.pose_convention={convention}, or provide"
    return (
        f"{change} camera-to-world poses with x right, y down, z forward, in frame order. To use the poses "
        "as given, set scan.check_poses=false."
    )


def compute_relative_poses(poses: Sequence[Pose], first: int, second: int) -> dict[str, Pose]:
    """Compute second_from_first under each candidate convention.

    Parameters
    ----------
    poses : poses of all frames, as read.
    first, second : indices of the two frames.

    Returns
    -------
    Relative poses (4, 4), by the description of the convention.
    """
    relative_poses = {
        name: invert_pose(to_camera_to_world(poses[second], convention))
        @ to_camera_to_world(poses[first], convention)
        for name, convention in _CONVENTION_BY_DESCRIPTION.items()
    }
    reversed_order = invert_pose(poses[-1 - second]) @ poses[-1 - first]
    return {**relative_poses, "in reverse frame order": reversed_order}
