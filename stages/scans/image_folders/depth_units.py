"""Inference of the depth unit from the values of depth maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_raw_depth
from scanloom.stages.files.noting import only_looking

MILLIMETRES, FIFTHS = 1000.0, 5000.0

_LOOKED_AT = 5
# Sample about this many rows of each map, with the same spacing between columns.
_ROWS = 60
# Fewer distinct values (a single wall, a drawn scene) do not determine the unit.
_LEAST_VALUES = 50
# Sensors report whole millimetres. In units of 1/5000 m, nearly all values are then multiples of five,
# against 20 % in other units. The remaining 10 % allow for interpolated values.
_WHOLE = 0.9
# Metres. Cameras whose depth is stored in 1/5000 m (Kinect and similar) measure nothing nearer. A smaller
# median depth rules that unit out.
_NEAREST = 0.4


def told_units(files: Sequence[Path]) -> float | None:
    """Infer the depth scale from the values of depth maps.

    Parameters
    ----------
    files : depth maps. A sample of five is read; unreadable files and files that are not 16-bit are
        ignored.

    Returns
    -------
    float or None
        1000 (millimetres) or 5000 (TUM) units per metre; None if both are plausible or there are too few
        values.
    """
    values = _values(files)
    if len(np.unique(values)) < _LEAST_VALUES:
        return None
    if np.mean(values % 5 == 0) > _WHOLE:
        return FIFTHS
    return MILLIMETRES if np.median(values) < _NEAREST * FIFTHS else None


def _values(files: Sequence[Path]) -> NDArray[np.uint16]:
    chosen = np.unique(np.linspace(0, max(len(files) - 1, 0), _LOOKED_AT).round().astype(int))
    found = []
    with only_looking():
        for path in (files[place] for place in chosen if files):
            try:
                raw = read_raw_depth(path)
            except InputError:
                continue  # Reported when the frame is read.
            if raw.dtype == np.uint16:
                step = max(1, raw.shape[0] // _ROWS)
                seen = raw[::step, ::step]
                found.append(seen[(seen > 0) & (seen < np.iinfo(np.uint16).max)])
    return np.concatenate(found) if found else np.zeros(0, np.uint16)
