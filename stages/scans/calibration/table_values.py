"""Validated access to calibration tables: numbers, rows, matrices and nested tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID, SCAN_TABLE_DAMAGED

# Key names of a camera matrix in various programs.
MATRIX_KEYS = ("intrinsic_matrix", "matrix", "camera_matrix", "K", "k", "mtx", "cam_K")


def get_matrix(values: dict[str, Any], key: str, path: Path) -> NDArray[np.float64]:
    """Read a matrix of a calibration table.

    Forms: nested rows, a flat list, or OpenCV's rows, cols and data.

    Raises
    ------
    InputError
        If the value is not a matrix of numbers.
    """
    value = values[key]
    shape: tuple[int, ...] | None = None
    try:
        if isinstance(value, dict):
            shape = int(value["rows"]), int(value["cols"])
            value = value["data"]
        array = np.asarray(value, np.float64)
        shape = shape or {9: (3, 3), 12: (3, 4), 16: (4, 4)}.get(array.size, array.shape)
        return array.reshape(shape)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "{key} is not a matrix of numbers.", path, key=key
        ) from error


def flatten_numbers(value: object, name: str, path: Path) -> tuple[float, ...]:
    """Flatten a list of numbers of any shape to a tuple.

    The result is empty for None.

    Raises
    ------
    InputError
        If the value is not numeric.
    """
    if value is None:
        return ()
    return tuple(float(number) for number in get_matrix({name: value}, name, path).ravel())


def to_finite_number(value: object, key: str, path: Path) -> float:
    """Convert a value to a finite number.

    Raises
    ------
    InputError
        If the value is not a finite number; the message names its `key`.
    """
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "{key} is {value!r}; a number is expected.",
            path,
            key=key,
            value=str(value)[:40],
        )
    return number


def get_table(values: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    """Return a nested table.

    Raises
    ------
    InputError
        If the value under `key` is not a table.
    """
    table = values[key]
    if not isinstance(table, dict):
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "{key} must be a table of names and values.", path, key=key
        )
    return table
