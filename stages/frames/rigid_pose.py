"""Check that the camera pose of a frame is rigid."""

from __future__ import annotations

import numpy as np

from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import FRAME_POSE_MISSING, POSE_INVALID
from scanloom.stages.scans.model.scan import Frame, Pose

# Maximum deviation of R Rᵀ from the identity. Poses read from text have few digits, and rotations of trackers
# drift.
_RIGID_TOLERANCE = 1e-2


def require_rigid_pose(frame: Frame) -> Pose:
    """Return the camera pose of a frame, checked to be rigid, as float64.

    Raises
    ------
    InputError
        If the frame has no pose, or its pose is not a rotation and a translation.
    """
    if frame.world_from_camera is None:
        raise InputError(FRAME_POSE_MISSING, "there is no camera pose.", DiagnosticLocation(frame=frame.name))
    pose = np.asarray(frame.world_from_camera, np.float64)
    rotation = pose[:3, :3]
    if not np.isfinite(pose).all():
        raise InputError(POSE_INVALID, "the camera pose is not finite.", DiagnosticLocation(frame=frame.name))
    deviation = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if deviation > _RIGID_TOLERANCE or np.linalg.det(rotation) < 0:
        raise InputError(
            POSE_INVALID,
            "the camera pose is not a rotation and a translation.",
            DiagnosticLocation(frame=frame.name),
        )
    return pose
