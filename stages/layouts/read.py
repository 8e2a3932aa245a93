"""Recognise a scan folder and read it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stages.errors import InputError, UsageError
from stages.layouts.layout import Layout
from stages.layouts.params import ScanParams
from stages.layouts.table import LAYOUTS
from stages.scan import Frame, Scan


def read_scan(folder: Path | str, options: ScanParams | None = None) -> Scan:
    """Read a scan folder: frames in order, in metres and OpenCV axes, images left on disk until asked for.

    Parameters
    ----------
    folder : the folder that holds the scan.
    options : what to use in place of what the folder says.

    Raises
    ------
    InputError
        If the folder is of no known layout, or something a scan needs is missing or wrong.
    """
    folder = Path(folder)
    options = options or ScanParams()
    layout = next((one for one in LAYOUTS if one.name == options.layout), None) or recognise(folder)[0]
    scan = layout.read(folder, options)
    if not scan.frames:
        reason = f": {scan.skipped[0].name}: {scan.skipped[0].reason}" if scan.skipped else ""
        raise InputError(f"none of its {len(scan.skipped)} frames can be used{reason}.", folder)
    _require_motion(scan.frames, folder)
    warnings = (*scan.warnings, *_time_warnings(scan.frames))
    return replace(scan, frames=_selected(scan.frames, options), warnings=warnings)


def recognise(folder: Path) -> tuple[Layout, str]:
    """Return the layout of a folder and why it is taken for it.

    Raises
    ------
    InputError
        If there is no such folder, it is empty, or of no layout that can be read.
    """
    if not folder.is_dir():
        problem = "this is a file, not a scan folder." if folder.exists() else "there is no such folder."
        raise InputError(problem, folder)
    for layout in LAYOUTS:
        reason = layout.matches(folder)
        if reason is not None:
            return layout, reason
    raise InputError("unknown layout", folder)


def _selected(frames: Sequence[Frame], options: ScanParams) -> Sequence[Frame]:
    end = None if options.last is None else options.last + 1
    chosen = frames[options.first : end : options.every]
    if not chosen:
        raise UsageError(
            f"first={options.first}, last={options.last} leaves no frame of the scan's {len(frames)}."
        )
    return chosen


def _require_motion(frames: Sequence[Frame], folder: Path) -> None:
    """Refuse constant poses: recorders without tracking write the same one for every frame."""
    poses = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
    if len(poses) > 1 and all(np.array_equal(poses[0], pose) for pose in poses[1:]):
        raise InputError(
            f"no poses: all {len(poses)} frames have the same one. Give a trajectory with scan.poses=FILE.",
            folder,
        )


def _time_warnings(frames: Sequence[Frame]) -> list[str]:
    times = [frame.timestamp for frame in frames if frame.timestamp is not None]
    steps = np.diff(np.array(times, np.int64))
    warnings = []
    if (steps == 0).any():
        warnings.append(f"{int((steps == 0).sum())} timestamps are repeated")
    if (steps < 0).any():
        warnings.append(f"{int((steps < 0).sum())} timestamps are earlier than the one before")
    gaps = int((steps > 5 * max(np.median(steps), 1)).sum()) if len(steps) else 0
    if gaps:
        warnings.append(f"{gaps} gaps in time are longer than five frames")
    return warnings
