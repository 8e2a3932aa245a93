"""Diagnostics of scans without poses or calibration, for `Scan.missing`."""

from __future__ import annotations

from typing import Any

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.scans.codes import CAMERA_PAIR_UNCALIBRATED, POSE_MISSING

_NAME_TRAJECTORY = "name a trajectory with scan.poses=FILE"
_NAME_CALIBRATION = "name one with scan.calibration=FILE"


def poses_missing(reason: str, /, *, remedy: str = _NAME_TRAJECTORY, **values: Any) -> Diagnostic:
    """Create the diagnostic of a scan without poses.

    `reason` and `remedy` are templates.
    """
    return POSE_MISSING.warning(f"no poses: {reason}", remedy=remedy, **values)


def calibration_missing(reason: str, /, *, remedy: str = _NAME_CALIBRATION, **values: Any) -> Diagnostic:
    """Create the diagnostic of a scan without calibration.

    `reason` and `remedy` are templates.
    """
    return CAMERA_PAIR_UNCALIBRATED.warning(f"no calibration: {reason}", remedy=remedy, **values)
