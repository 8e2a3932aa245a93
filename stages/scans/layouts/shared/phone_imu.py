"""Accelerometer data of Stray Scanner (imu.csv).

Each row has a time (clock of odometry.csv, seconds), three accelerations and three angular rates, in
phone axes: x right, y up, z out of the screen. Apple's readings point down at rest; they are in g, or
in m/s² in older versions.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import SCALE_UP_UNCERTAIN
from scanloom.stages.scans.streams.timestamped_streams import Accelerometer

_COLUMNS = ("timestamp", "a_x", "a_y", "a_z")
# Images are stored in landscape orientation: camera x points down the phone, camera y to its left, and the
# camera looks out of its back.
_CAMERA_FROM_PHONE = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_MAX_TIME_S = 1 << 32


def read_phone_accelerometer(path: Path) -> Accelerometer | None:
    """Read the accelerometer of imu.csv; None if the file does not exist."""
    if not path.is_file():
        return None
    lines = list(documents.iterate_lines(path))
    header = [name.strip().lower() for name in lines[0][1].split(",")] if lines else []
    if lacking := [name for name in _COLUMNS if name not in header]:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "the column {columns} is missing: the accelerometer is not used",
                path,
                columns=", ".join(lacking),
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
        if abs(row[0]) < _MAX_TIME_S:
            rows.append(row)
    if len(rows) < len(lines) - 1:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "{count} of {line_count} lines are not valid readings; they are ignored",
                path,
                count=len(lines) - 1 - len(rows),
                line_count=len(lines) - 1,
            )
        )
    values = np.array(rows, np.float64).reshape(-1, 4)
    times = np.rint(values[:, 0] * 1e9).astype(np.int64)
    return Accelerometer(path.name, times, lambda number: -values[number, 1:], _CAMERA_FROM_PHONE)
