"""Up direction of a scan, from its layout or from the accelerometers of its frames.

Phones align their world to gravity, so the up direction of each camera follows from its original pose. It is
stored with the frames and remains valid if other poses are estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.scans.codes import SCALE_UP_UNCERTAIN
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.scans.model.world import Direction, WorldUp, create_layout_up

# Degrees. Hand shake deviates by a few degrees; a larger median deviation means that accelerometer and poses
# are inconsistent.
_MAX_SPREAD_DEG = 20.0


def set_layout_up(scan: Scan, layout: Layout, options: ReadingParams) -> Scan:
    """Set the up direction that the layout defines.

    It is valid only for the original poses of the layout, not for poses from another file.
    """
    if options.poses is not None or not scan.has_poses:
        return replace(scan, up=None)
    if scan.up is not None or layout.up is None:
        return scan
    frames = _store_camera_ups(scan.frames, layout.up) if layout.is_gravity_aligned else scan.frames
    return replace(scan, frames=frames, up=create_layout_up(layout.name, layout.up))


def _store_camera_ups(frames: Sequence[Frame], up: Direction) -> list[Frame]:
    """Store the up direction in the camera axes of each frame that has a pose.

    It remains valid if other poses replace the original ones.
    """
    return [
        frame
        if frame.world_from_camera is None or frame.up is not None
        else replace(frame, up=frame.world_from_camera[:3, :3].T @ np.array(up))
        for frame in frames
    ]


def find_up_direction(scan: Scan) -> WorldUp | None:
    """Return the up direction in world coordinates; None if unknown.

    The direction of the layout has priority. Otherwise the directions that were measured per frame are
    averaged. Emits a warning if these are inconsistent with the poses.
    """
    return _average_measured_ups(scan.frames) if scan.up is None else scan.up


def _average_measured_ups(frames: Sequence[Frame]) -> WorldUp | None:
    """Compute the median of the frames' up directions in world coordinates."""
    found = [
        frame.world_from_camera[:3, :3] @ frame.up
        for frame in frames
        if frame.world_from_camera is not None and frame.up is not None
    ]
    if not found:
        return None
    directions = np.array(found)
    median = np.median(directions, axis=0)
    length = float(np.linalg.norm(median))
    up = median / max(length, np.finfo(np.float64).tiny)
    spread = float(np.median(np.degrees(np.arccos(np.clip(directions @ up, -1, 1)))))
    if spread > _MAX_SPREAD_DEG:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "the up direction of the accelerometer is inconsistent with the poses: it varies by "
                "{spread:.0f}° (median) between frames; it is not used",
                spread=spread,
            )
        )
        return None
    x, y, z = up.tolist()
    return WorldUp((x, y, z), "gravity of the IMU")
