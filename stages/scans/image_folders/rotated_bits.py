"""Depth maps with 16-bit values rotated left by three bits.

SUN3D, SUN RGB-D and the APC toolbox store depth in this way.

The encoding is detected from the values. Depth below 8192 is stored as a multiple of eight, and larger
depth wraps around to small values. In correctly decoded depth, neighbouring pixels differ little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DEPTH_FORMAT
from scanloom.stages.files.file_access_log import pause_recording
from scanloom.stages.files.images import read_raw_depth
from scanloom.stages.scans.codes import SCAN_ASSUMED
from scanloom.stages.scans.model.scan import PackedImage, Scan

_SAMPLE_COUNT = 2
_MM_UNITS_PER_METRE = 1000.0
# Unit of the APC toolbox, for decoded values. A user who states this scale means rotated bits: hardly any
# sensor has a resolution of eight units.
_TENTH_MM_UNITS_PER_METRE = 10000.0
# Maps with fewer valid pixels or fewer distinct values are not tested.
_MIN_PIXELS = 1000
_MIN_DISTINCT_VALUES = 64
# Minimum difference of neighbouring pixels that counts as a jump. If plain values are decoded as rotated
# ones, nearly all neighbours jump.
_JUMP_SIZE = 1 << 12
_MAX_JUMP_RATIO = 0.05
# Minimum ratio of odd values after decoding. If there are fewer, the values are multiples of 16 or more, from
# rounding and not from rotation.
_MIN_ODD_RATIO = 0.2
# Maximum ratio of values that are not multiples of eight in a rotated map (noise).
_MAX_PLAIN_RATIO = 0.001


def decode_rotated(raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Decode rotated depth (h, w) uint16: rotate each value right by three bits."""
    return np.asarray((raw >> 3) | (raw << 13), np.uint16)


def read_rotated(path: Path) -> NDArray[np.uint16]:
    """Read a depth file and decode its rotated bits, (h, w) uint16.

    Raises
    ------
    InputError
        If the file is not a 16-bit image.
    """
    raw = read_raw_depth(path)
    if raw.dtype != np.uint16:
        raise InputError(FILE_DEPTH_FORMAT, "a 16-bit depth map is expected.", path)
    return decode_rotated(raw)


def is_rotated(raw: NDArray[np.uint16], *, is_scale_stated: bool) -> bool:
    """Detect rotated bits in a depth map (h, w) uint16.

    Parameters
    ----------
    is_scale_stated : the user states the depth unit, so multiples of eight can be genuine values.
    """
    known = raw > 0
    if np.count_nonzero(known) < _MIN_PIXELS or len(np.unique(raw[known])) < _MIN_DISTINCT_VALUES:
        return False
    decoded = decode_rotated(raw)
    jumps, jumps_turned = (_measure_jump_ratio(values, known) for values in (raw, decoded))
    if jumps_turned > _MAX_JUMP_RATIO:
        return False
    if np.count_nonzero(raw[known] & 7) > _MAX_PLAIN_RATIO * np.count_nonzero(known):
        return jumps_turned < jumps
    return not is_scale_stated and bool(np.mean(decoded[known] & 1) > _MIN_ODD_RATIO)


def decode_rotated_scan(scan: Scan, stated_depth_scale: float | None, *, is_own_layout: bool) -> Scan:
    """Decode the depth maps of a scan whose bits are rotated.

    Emits a warning if so.

    Parameters
    ----------
    stated_depth_scale : depth units per metre given by the user, or None.
    is_own_layout : the scan is in scanloom's own layout, whose stated unit is trusted.
    """
    files = [frame.depth for frame in scan.frames if isinstance(frame.depth, Path)]
    # Rotated values are in units of 1 mm or 0.1 mm; any other scale was stated deliberately.
    usual = _MM_UNITS_PER_METRE if stated_depth_scale is None else _TENTH_MM_UNITS_PER_METRE
    is_scale_stated = is_own_layout or any(frame.depth_scale != usual for frame in scan.frames)
    if not files or not detect_rotated_files(files, is_scale_stated=is_scale_stated):
        return scan
    frames = [
        replace(frame, depth=PackedImage(frame.depth, "depth", partial(read_rotated, frame.depth)))
        if isinstance(frame.depth, Path)
        else frame
        for frame in scan.frames
    ]
    is_millimetres = frames[0].depth_scale == _MM_UNITS_PER_METRE
    emit(
        SCAN_ASSUMED.warning(
            "the depth values are stored with their bits rotated by three (as in SUN3D); they are "
            "decoded, with {scale:g} units per metre",
            remedy="if they are in units of 0.1 mm, set scan.depth_scale=10000" if is_millimetres else "",
            scale=frames[0].depth_scale,
        )
    )
    return replace(scan, frames=frames)


def detect_rotated_files(files: Sequence[Path], *, is_scale_stated: bool) -> bool:
    """Detect rotated bits in depth files, judged by two of them.

    See `is_rotated`.
    """
    with pause_recording():
        maps = [
            _read_raw_or_none(path) for path in files[:: max(1, len(files) // _SAMPLE_COUNT)][:_SAMPLE_COUNT]
        ]
    found = [raw for raw in maps if raw is not None]
    return bool(found) and all(is_rotated(raw, is_scale_stated=is_scale_stated) for raw in found)


def _read_raw_or_none(path: Path) -> NDArray[np.uint16] | None:
    try:
        raw = read_raw_depth(path)
    except InputError:
        return None
    return raw if raw.dtype == np.uint16 else None


def _measure_jump_ratio(values: NDArray[np.uint16], known: NDArray[np.bool_]) -> float:
    """Return the ratio of adjacent valid pixels whose values differ by a jump.

    Only horizontal neighbours are compared.
    """
    both = known[:, 1:] & known[:, :-1]
    steps = np.abs(np.diff(values.astype(np.int32), axis=1))[both]
    return float(np.mean(steps > _JUMP_SIZE)) if steps.size else 1.0
