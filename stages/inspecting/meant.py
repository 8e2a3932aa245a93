"""The ways in which poses can be meant, whatever a file's own form says: direction, axes, order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.scans.poses import WORLD_TO_CAMERA, WORLD_TO_CAMERA_Y_UP, Y_UP, inverted
from stages.scans.scan import Pose

AS_GIVEN = "as given"
# The values of scan.pose_convention, by how a sentence calls them.
CONVENTIONS = {
    WORLD_TO_CAMERA: WORLD_TO_CAMERA,
    "of a camera with y up and z back": Y_UP,
    "world-to-camera, with y up and z back": WORLD_TO_CAMERA_Y_UP,
}
_FLIP = np.diag((1.0, -1.0, -1.0, 1.0))


def advice(best: str) -> str:
    """Return the sentence that says what to do where the poses are probably meant another way."""
    convention = CONVENTIONS.get(best)
    change = "Give them" if convention is None else f"Set scan.pose_convention={convention}, or give them"
    return (
        f"{change} camera-to-world with x right, y down, z forward, in the frames' order, or use them as "
        "they are with --no-check-poses (in a config file: check_poses = false under [scan])."
    )


def motions(poses: Sequence[Pose], first: int, second: int) -> dict[str, Pose]:
    """Return second_from_first as each way to take the poses gives it, by how a sentence calls it."""
    given = inverted(poses[second]) @ poses[first]
    turned = poses[second] @ inverted(poses[first])
    ways = (turned, _FLIP @ given @ _FLIP, _FLIP @ turned @ _FLIP)
    return {
        AS_GIVEN: given,
        **dict(zip(CONVENTIONS, ways, strict=True)),
        "in the order of the frames backwards": inverted(poses[-1 - second]) @ poses[-1 - first],
    }
