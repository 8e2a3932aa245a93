"""Diagnostics of scans without poses or calibration, for `Scan.missing`."""

from __future__ import annotations

from typing import Any

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.scans.codes import CAMERA_PAIR_UNCALIBRATED, POSE_MISSING

_TRAJECTORY_REMEDY = "name a trajectory with scan.poses=FILE"
_CALIBRATION_REMEDY = "name one with scan.calibration=FILE"


def describe_missing_poses(reason: str, /, *, remedy: str = _TRAJECTORY_REMEDY, **values: Any) -> Diagnostic:
    """Create the diagnostic of a scan without poses.

    `reason` and `remedy` are templates.
    """
    return POSE_MISSING.warning(f"no poses: {reason}", remedy=remedy, **values)


def describe_missing_calibration(
    reason: str, /, *, remedy: str = _CALIBRATION_REMEDY, **values: Any
) -> Diagnostic:
    """Create the diagnostic of a scan without calibration.

    `reason` and `remedy` are templates.
    """
    return CAMERA_PAIR_UNCALIBRATED.warning(f"no calibration: {reason}", remedy=remedy, **values)
