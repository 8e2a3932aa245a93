"""The ways in which poses can be meant, whatever a file's own form says: direction, axes, order."""

from __future__ import annotations

from collections.abc import Sequence

from scanloom.stages.scans.model.poses import (
    AS_WRITTEN,
    WORLD_TO_CAMERA,
    WORLD_TO_CAMERA_Y_UP,
    Y_UP,
    inverted,
    meant,
)
from scanloom.stages.scans.model.scan import Pose

AS_GIVEN = "as given"
# The values of scan.pose_convention, by how a sentence calls them.
_CONVENTIONS = {
    AS_GIVEN: AS_WRITTEN,
    WORLD_TO_CAMERA: WORLD_TO_CAMERA,
    "of a camera with y up and z back": Y_UP,
    "world-to-camera, with y up and z back": WORLD_TO_CAMERA_Y_UP,
}


def advice(best: str) -> str:
    """Return the sentence that says what to do where the poses are probably meant another way."""
    convention = _CONVENTIONS.get(best)
    change = "Give them" if convention is None else f"Set scan.pose_convention={convention}, or give them"
    return (
        f"{change} camera-to-world with x right, y down, z forward, in the frames' order, or use them as "
        "they are with scan.check_poses=false."
    )


def motions(poses: Sequence[Pose], first: int, second: int) -> dict[str, Pose]:
    """Return second_from_first as each way to take the poses gives it, by how a sentence calls it."""
    ways = {
        name: inverted(meant(poses[second], convention)) @ meant(poses[first], convention)
        for name, convention in _CONVENTIONS.items()
    }
    backwards = inverted(poses[-1 - second]) @ poses[-1 - first]
    return {**ways, "in the order of the frames backwards": backwards}
