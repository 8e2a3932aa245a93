"""Up direction per frame from an accelerometer, which measures gravity at rest.

Hand motion adds accelerations, but smaller ones in all directions, which average out over many frames.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import SCALE_UP_UNCERTAIN
from scanloom.stages.scans.streams.clocked_streams import Accelerometer

Floats = NDArray[np.float64]

# Maximum total number of readings, spread over the file. Each needs a file access, so that only some frames
# of a long recording get an up direction.
_MOST_READINGS = 200
# Maximum number of readings averaged per frame, and their maximum time difference to the frame in
# nanoseconds.
_MOST_A_FRAME, _NEAR = 9, 100_000_000
# Gravity in the units that drivers use (m/s², or g), and the relative tolerance of accelerometers.
_GRAVITIES, _OFF_SHARE = (9.81, 1.0), 0.12
# A reading that deviates from the median by a larger ratio is a jolt; one above 1e4 m/s² is damaged.
_JOLT, _LARGEST = 0.2, 1e4


def ups_of(accelerometer: Accelerometer | None, moments: NDArray[np.int64]) -> list[Floats | None]:
    """Estimate the up direction of each frame from accelerometer readings.

    Parameters
    ----------
    moments : (n,) recording times of the frames, nanoseconds.

    Returns
    -------
    list
        Per frame a unit vector (3,) in camera axes, or None.
    """
    ups: list[Floats | None] = [None] * len(moments)
    if accelerometer is None or not len(accelerometer.recorded):
        return ups
    if accelerometer.camera_from_it is None:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "the recording does not contain the orientation of {name} relative to the camera: {name} "
                "is not used for the up direction",
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
    """Return the valid readings (n, 3) closest in time to a frame."""
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
