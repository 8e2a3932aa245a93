"""What is up for a camera while it records, by the accelerometer beside it: at rest that measures up.

Hands accelerate it, too, but by less than gravity and to all sides: over many frames it is off by little.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import SCALE_UP_UNCERTAIN
from scanloom.stages.scans.streams.clocked_streams import Accelerometer

Floats = NDArray[np.float64]

# Readings are taken from all over a file, each for itself: of a long recording some frames know what is up.
_MOST_READINGS = 200
# For a frame it is the mean of so many readings at most, none of them recorded farther from it, nanoseconds.
_MOST_A_FRAME, _NEAR = 9, 100_000_000
# What gravity is in the units of drivers (m/s², or g), and the share by which accelerometers are off.
_GRAVITIES, _OFF_SHARE = (9.81, 1.0), 0.12
# A reading that is off by a larger share of that is of a jolt; one of more (m/s²) is damaged.
_JOLT, _LARGEST = 0.2, 1e4


def ups_of(accelerometer: Accelerometer | None, moments: NDArray[np.int64]) -> list[Floats | None]:
    """Return the up direction in the axes of the camera, (3,) of length 1, for each frame, or None.

    Parameters
    ----------
    moments : (n,) nanoseconds at which the frames were recorded.
    """
    ups: list[Floats | None] = [None] * len(moments)
    if accelerometer is None or not len(accelerometer.recorded):
        return ups
    if accelerometer.camera_from_it is None:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "how {name} stands to the camera is not in the recording: what it says is up is not used",
                name=accelerometer.name,
            )
        )
        return ups
    chosen = np.unique(np.linspace(0, len(moments) - 1, _MOST_READINGS).round().astype(int)).tolist()
    each = min(_MOST_READINGS // len(chosen), _MOST_A_FRAME)
    near = {at: _near(accelerometer, int(moments[at]), each) for at in chosen}
    lengths = np.concatenate([np.linalg.norm(readings, axis=1) for readings in near.values()])
    if not len(lengths):
        return ups
    usual = float(np.median(lengths))
    if not any(abs(usual / gravity - 1) <= _OFF_SHARE for gravity in _GRAVITIES):
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "{name} reads {usual:.3g} m/s² (median), which is not gravity: it is not used",
                name=accelerometer.name,
                usual=usual,
            )
        )
        return ups
    for at, readings in near.items():
        calm = readings[np.abs(np.linalg.norm(readings, axis=1) / usual - 1) <= _JOLT]
        total = calm.sum(axis=0)
        if len(calm) and np.linalg.norm(total) > 0:
            ups[at] = accelerometer.camera_from_it @ (total / np.linalg.norm(total))
    return ups


def _near(accelerometer: Accelerometer, moment: int, most: int) -> Floats:
    """Return the sound ones (n, 3) of the readings recorded nearest to a moment."""
    off = np.abs(accelerometer.recorded - moment)
    near = np.argsort(off, kind="stable")[:most]
    found = (_reading(accelerometer, number) for number in near[off[near] <= _NEAR].tolist())
    return np.reshape([reading for reading in found if reading is not None], (-1, 3))


def _reading(accelerometer: Accelerometer, number: int) -> Floats | None:
    try:
        reading = accelerometer.read(number)
    except InputError:
        return None
    return reading if (np.abs(reading) < _LARGEST).all() else None
