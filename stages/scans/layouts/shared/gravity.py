"""Up direction per frame from an accelerometer, which measures gravity at rest.

Hand motion adds accelerations, but smaller ones in all directions, which average out over many frames.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import SCALE_UP_UNCERTAIN
from scanloom.stages.scans.streams.timestamped_streams import Accelerometer

Floats = NDArray[np.float64]

# Maximum total number of readings, spread over the file. Each needs a file access, so that only some frames
# of a long recording get an up direction.
_MAX_READING_COUNT = 200
# Maximum number of readings averaged per frame, and their maximum time difference to the frame in
# nanoseconds.
_MAX_READINGS_PER_FRAME, _MAX_TIME_DIFFERENCE_NS = 9, 100_000_000
# Gravity in the units that drivers use (m/s², or g), and the relative tolerance of accelerometers.
_GRAVITY_VALUES, _GRAVITY_TOLERANCE = (9.81, 1.0), 0.12
# A reading that deviates from the median by a larger ratio is a jolt; one above 1e4 m/s² is damaged.
_MAX_DEVIATION_RATIO, _MAX_ACCELERATION = 0.2, 1e4


def estimate_up_directions(
    accelerometer: Accelerometer | None, frame_times_ns: NDArray[np.int64]
) -> list[Floats | None]:
    """Estimate the up direction of each frame from accelerometer readings.

    Parameters
    ----------
    frame_times_ns : (n,) recording times of the frames, nanoseconds.

    Returns
    -------
    list
        Per frame a unit vector (3,) in camera axes, or None.
    """
    ups: list[Floats | None] = [None] * len(frame_times_ns)
    if accelerometer is None or not len(accelerometer.record_times_ns):
        return ups
    if accelerometer.camera_from_sensor is None:
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "the recording does not contain the orientation of {name} relative to the camera: {name} "
                "is not used for the up direction",
                name=accelerometer.name,
            )
        )
        return ups
    chosen = np.unique(
        np.linspace(0, len(frame_times_ns) - 1, _MAX_READING_COUNT).round().astype(int)
    ).tolist()
    each = min(_MAX_READING_COUNT // len(chosen), _MAX_READINGS_PER_FRAME)
    near = {at: _read_nearest(accelerometer, int(frame_times_ns[at]), each) for at in chosen}
    lengths = np.concatenate([np.linalg.norm(readings, axis=1) for readings in near.values()])
    if not len(lengths):
        return ups
    median_length = float(np.median(lengths))
    if not any(abs(median_length / gravity - 1) <= _GRAVITY_TOLERANCE for gravity in _GRAVITY_VALUES):
        emit(
            SCALE_UP_UNCERTAIN.warning(
                "{name} reads {usual:.3g} m/s² (median), which is not gravity: it is not used",
                name=accelerometer.name,
                usual=median_length,
            )
        )
        return ups
    for at, readings in near.items():
        calm = readings[np.abs(np.linalg.norm(readings, axis=1) / median_length - 1) <= _MAX_DEVIATION_RATIO]
        total = calm.sum(axis=0)
        if len(calm) and np.linalg.norm(total) > 0:
            ups[at] = accelerometer.camera_from_sensor @ (total / np.linalg.norm(total))
    return ups


def _read_nearest(accelerometer: Accelerometer, frame_time_ns: int, max_count: int) -> Floats:
    """Return the valid readings (n, 3) closest in time to a frame."""
    off = np.abs(accelerometer.record_times_ns - frame_time_ns)
    near = np.argsort(off, kind="stable")[:max_count]
    found = (
        _read_valid(accelerometer, number) for number in near[off[near] <= _MAX_TIME_DIFFERENCE_NS].tolist()
    )
    return np.reshape([reading for reading in found if reading is not None], (-1, 3))


def _read_valid(accelerometer: Accelerometer, number: int) -> Floats | None:
    try:
        reading = accelerometer.read(number)
    except InputError:
        return None
    return reading if (np.abs(reading) < _MAX_ACCELERATION).all() else None
