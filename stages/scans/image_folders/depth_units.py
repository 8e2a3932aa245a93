"""What the values of depth maps tell of their unit, where no file states it."""

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
# Of each map so many rows are enough, and columns as far apart.
_ROWS = 60
# A handful of values, of a wall or of a drawn scene, tells nothing.
_LEAST_VALUES = 50
# Depth cameras measure whole millimetres; so many of the values are then multiples of five, where a fifth of
# others are. What is left for values that were interpolated.
_WHOLE = 0.9
# Metres. No camera that recordings in fifths of a millimetre are made with (a Kinect, its like) sees nearer,
# and no room is so small that half of what it shows is.
_NEAREST = 0.4


def told_units(files: Sequence[Path]) -> float | None:
    """Return how many units a metre depth maps must be in, 1000 or 5000; None where they could be in either.

    Parameters
    ----------
    files : depth maps; a few of them are read, and those that cannot be, or are not of 16 bits, are left out.
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
                continue  # Told where the frame is read.
            if raw.dtype == np.uint16:
                step = max(1, raw.shape[0] // _ROWS)
                seen = raw[::step, ::step]
                found.append(seen[(seen > 0) & (seen < np.iinfo(np.uint16).max)])
    return np.concatenate(found) if found else np.zeros(0, np.uint16)
