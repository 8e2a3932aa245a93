"""imu.csv of Stray Scanner: the phone's accelerometer, which tells what is up where no pose of its own does.

A row is a time (of odometry.csv's clock, seconds), three accelerations and three rates of turning, in the
axes of the phone: x to the right, y up, z out of the screen. Apple's readings point down at rest; they are in
g, those of older versions in m/s².
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import SCALE_UP_UNCERTAIN
from scanloom.stages.scans.streams.clocked_streams import Accelerometer

_COLUMNS = ("timestamp", "a_x", "a_y", "a_z")
# The camera's x goes down the phone, its y to the left, for its images lie on their side: and it looks back.
_CAMERA_FROM_PHONE = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_LATEST_S = 1 << 32


def phone_accelerometer(path: Path) -> Accelerometer | None:
    """Return the readings of imu.csv, None where there are none."""
    if not path.is_file():
        return None
    lines = list(documents.lines(path))
    header = [name.strip().lower() for name in lines[0][1].split(",")] if lines else []
    if lacking := [name for name in _COLUMNS if name not in header]:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "it is not used: its first line names no column {columns}", path, columns=", ".join(lacking)
            )
        )
        return None
    columns = [header.index(name) for name in _COLUMNS]
    rows = []
    for _, text in lines[1:]:
        words = text.split(",")
        try:
            row = [float(words[column]) for column in columns]
        except (ValueError, IndexError):
            continue
        if abs(row[0]) < _LATEST_S:
            rows.append(row)
    if len(rows) < len(lines) - 1:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "{count} of {line_count} lines are no readings",
                path,
                count=len(lines) - 1 - len(rows),
                line_count=len(lines) - 1,
            )
        )
    values = np.array(rows, np.float64).reshape(-1, 4)
    times = np.rint(values[:, 0] * 1e9).astype(np.int64)
    return Accelerometer(path.name, times, lambda number: -values[number, 1:], _CAMERA_FROM_PHONE)
