"""Which way is up in a scan: as its layout defines it, or as the frames' accelerometers tell it.

Phones turn their worlds by gravity. Their own poses then tell what is up for each camera, and that goes with
the frames where poses are found anew.
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
from scanloom.stages.scans.model.world import Direction, WorldUp, up_of_layout

# Hands shake a camera by some degrees; readings that are off by more in the median do not go with the poses.
_LARGEST_SPREAD_DEG = 20.0


def with_up(scan: Scan, layout: Layout, options: ReadingParams) -> Scan:
    """Return a scan that was just read with what is up by its layout, where the poses are its own."""
    if options.poses is not None or not scan.has_poses:
        return replace(scan, up=None)
    if scan.up is not None or layout.up is None:
        return scan
    frames = _with_own_ups(scan.frames, layout.up) if layout.is_level else scan.frames
    return replace(scan, frames=frames, up=up_of_layout(layout.name, layout.up))


def _with_own_ups(frames: Sequence[Frame], up: Direction) -> list[Frame]:
    """Return frames that know what is up for their cameras, whatever world other poses put them in later."""
    return [
        frame
        if frame.world_from_camera is None or frame.up is not None
        else replace(frame, up=frame.world_from_camera[:3, :3].T @ np.array(up))
        for frame in frames
    ]


def known_up(scan: Scan) -> WorldUp | None:
    """Return the up direction in the world of the frames' poses, None where nothing says it.

    The direction of the layout counts; else the one measured while the frames were taken, which goes with
    them into any world that poses are found in. Emits a warning if it does not fit the poses.
    """
    return _measured(scan.frames) if scan.up is None else scan.up


def _measured(frames: Sequence[Frame]) -> WorldUp | None:
    """Return the median up direction of the frames, by coordinates of the world."""
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
    if spread > _LARGEST_SPREAD_DEG:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "what the accelerometer says is up does not go with the poses: it differs from frame to "
                "frame by {spread:.0f}° (median); it is not used",
                spread=spread,
            )
        )
        return None
    x, y, z = up.tolist()
    return WorldUp((x, y, z), "gravity of the IMU")
