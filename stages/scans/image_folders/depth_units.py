"""Inference of the depth unit from the values of depth maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.file_access_log import pause_recording
from scanloom.stages.files.images import read_raw_depth

MM_UNITS_PER_METRE, TUM_UNITS_PER_METRE = 1000.0, 5000.0

_SAMPLE_COUNT = 5
# Sample about this many rows of each map, with the same spacing between columns.
_SAMPLED_ROWS = 60
# Fewer distinct values (a single wall, a drawn scene) do not determine the unit.
_MIN_DISTINCT_VALUES = 50
# Sensors report whole millimetres. In units of 1/5000 m, nearly all values are then multiples of five,
# against 20 % in other units. The remaining 10 % allow for interpolated values.
_MIN_MULTIPLES_OF_FIVE_RATIO = 0.9
# Metres. Cameras whose depth is stored in 1/5000 m (Kinect and similar) measure nothing nearer. A smaller
# median depth rules that unit out.
_MIN_MEDIAN_DEPTH_M = 0.4


def infer_depth_scale(files: Sequence[Path]) -> float | None:
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
    values = _sample_values(files)
    if len(np.unique(values)) < _MIN_DISTINCT_VALUES:
        return None
    if np.mean(values % 5 == 0) > _MIN_MULTIPLES_OF_FIVE_RATIO:
        return TUM_UNITS_PER_METRE
    return MM_UNITS_PER_METRE if np.median(values) < _MIN_MEDIAN_DEPTH_M * TUM_UNITS_PER_METRE else None


def _sample_values(files: Sequence[Path]) -> NDArray[np.uint16]:
    chosen = np.unique(np.linspace(0, max(len(files) - 1, 0), _SAMPLE_COUNT).round().astype(int))
    found = []
    with pause_recording():
        for path in (files[place] for place in chosen if files):
            try:
                raw = read_raw_depth(path)
            except InputError:
                continue  # Reported when the frame is read.
            if raw.dtype == np.uint16:
                step = max(1, raw.shape[0] // _SAMPLED_ROWS)
                seen = raw[::step, ::step]
                found.append(seen[(seen > 0) & (seen < np.iinfo(np.uint16).max)])
    return np.concatenate(found) if found else np.zeros(0, np.uint16)
