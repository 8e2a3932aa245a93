"""Camera trajectory of a scan, with detection of pose jumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.printing import format_by_fields
from scanloom.stages.scans.codes import POSE_JUMPS
from scanloom.stages.scans.model.scan import Scan

# Metres and degrees between two frames. A person walking with a camera stays below both.
_MAX_STEP_M = 0.5
_MAX_ROTATION_DEG = 30.0


@dataclass(frozen=True)
class CameraTrajectory:
    """Statistics of the camera trajectory: lengths in metres, angles in degrees.

    `outliers` names the frames that follow a jump: a step of more than 0.5 m and five median steps, or a
    rotation of more than 30 degrees.
    """

    length_m: float
    box_m: tuple[float, float, float]
    max_step_m: float
    max_rotation_deg: float
    outliers: tuple[str, ...]

    __repr__ = format_by_fields


def measure_camera_path(scan: Scan) -> CameraTrajectory | None:
    """Measure the camera trajectory; emit a warning for pose jumps.

    Returns None for a scan without poses. Single views (photos) are unordered, so jumps are not reported for
    them.
    """
    frames = scan.frames
    poses = np.array([frame.world_from_camera for frame in frames if frame.world_from_camera is not None])
    if not len(poses):
        return None
    centres, rotations = poses[:, :3, 3], poses[:, :3, :3]
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    cosines = (np.einsum("nij,nij->n", rotations[:-1], rotations[1:]) - 1) / 2
    turns = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    # A camera on a car moves metres per frame. So a jump must exceed both the absolute limit and five median
    # steps.
    min_limit = _MAX_STEP_M if scan.is_metric else 0.0
    limit = max(min_limit, 5 * float(np.median(steps))) if len(steps) else 0.0
    jumps = np.flatnonzero((steps > limit) | (turns > _MAX_ROTATION_DEG))
    outliers = tuple(frames[i + 1].name for i in jumps)
    box = np.ptp(centres, axis=0)
    path = CameraTrajectory(
        length_m=float(steps.sum()),
        box_m=(float(box[0]), float(box[1]), float(box[2])),
        max_step_m=float(steps.max(initial=0.0)),
        max_rotation_deg=float(turns.max(initial=0.0)),
        outliers=outliers,
    )
    if outliers and not scan.is_views:
        emit(
            POSE_JUMPS.warning(
                "{count} poses jump by more than {step:.2g} {unit} or {turn:g}° from the previous frame: "
                "{named}",
                count=len(outliers),
                step=limit,
                unit="m" if scan.is_metric else "units",
                turn=_MAX_ROTATION_DEG,
                named=", ".join(outliers[:3]) + (" …" if len(outliers) > 3 else ""),
            )
        )
    return path
