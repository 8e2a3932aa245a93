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
from scanloom.stages.files.images import read_raw_depth
from scanloom.stages.files.noting import only_looking
from scanloom.stages.scans.codes import SCAN_ASSUMED
from scanloom.stages.scans.model.scan import Packed, Scan

_LOOKED_AT = 2
_MILLIMETRES = 1000.0
# Unit of the APC toolbox, for decoded values. A user who states this scale means rotated bits: hardly any
# sensor has a resolution of eight units.
_TENTHS_OF_MILLIMETRES = 10000.0
# Maps with fewer valid pixels or fewer distinct values are not tested.
_LEAST_PIXELS = 1000
_LEAST_VALUES = 64
# Minimum difference of neighbouring pixels that counts as a jump. If plain values are decoded as rotated
# ones, nearly all neighbours jump.
_JUMP = 1 << 12
_MOST_JUMPS = 0.05
# Minimum ratio of odd values after decoding. If there are fewer, the values are multiples of 16 or more, from
# rounding and not from rotation.
_LEAST_ODD = 0.2
# Maximum ratio of values that are not multiples of eight in a rotated map (noise).
_MOST_PLAIN = 0.001


def turned_back(raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Decode rotated depth (h, w) uint16: rotate each value right by three bits."""
    return np.asarray((raw >> 3) | (raw << 13), np.uint16)


def read_turned_back(path: Path) -> NDArray[np.uint16]:
    """Read a depth file and decode its rotated bits, (h, w) uint16.

    Raises
    ------
    InputError
        If the file is not a 16-bit image.
    """
    raw = read_raw_depth(path)
    if raw.dtype != np.uint16:
        raise InputError(FILE_DEPTH_FORMAT, "a 16-bit depth map is expected.", path)
    return turned_back(raw)


def is_rotated(raw: NDArray[np.uint16], *, is_scale_stated: bool) -> bool:
    """Detect rotated bits in a depth map (h, w) uint16.

    Parameters
    ----------
    is_scale_stated : the user states the depth unit, so multiples of eight can be genuine values.
    """
    known = raw > 0
    if np.count_nonzero(known) < _LEAST_PIXELS or len(np.unique(raw[known])) < _LEAST_VALUES:
        return False
    turned = turned_back(raw)
    jumps, jumps_turned = (_jumps(values, known) for values in (raw, turned))
    if jumps_turned > _MOST_JUMPS:
        return False
    if np.count_nonzero(raw[known] & 7) > _MOST_PLAIN * np.count_nonzero(known):
        return jumps_turned < jumps
    return not is_scale_stated and bool(np.mean(turned[known] & 1) > _LEAST_ODD)


def with_bits_turned_back(scan: Scan, stated: float | None, *, is_own: bool) -> Scan:
    """Decode the depth maps of a scan whose bits are rotated.

    Emits a warning if so.

    Parameters
    ----------
    stated : depth units per metre given by the user, or None.
    is_own : the scan is in scanloom's own layout, whose stated unit is trusted.
    """
    files = [frame.depth for frame in scan.frames if isinstance(frame.depth, Path)]
    # Rotated values are in units of 1 mm or 0.1 mm; any other scale was stated deliberately.
    usual = _MILLIMETRES if stated is None else _TENTHS_OF_MILLIMETRES
    is_scale_stated = is_own or any(frame.depth_scale != usual for frame in scan.frames)
    if not files or not are_rotated(files, is_scale_stated=is_scale_stated):
        return scan
    frames = [
        replace(frame, depth=Packed(frame.depth, "depth", partial(read_turned_back, frame.depth)))
        if isinstance(frame.depth, Path)
        else frame
        for frame in scan.frames
    ]
    is_millimetres = frames[0].depth_scale == _MILLIMETRES
    emit(
        SCAN_ASSUMED.warning(
            "the depth values are stored with their bits rotated by three (as in SUN3D); they are "
            "decoded, with {scale:g} units per metre",
            remedy="if they are in units of 0.1 mm, set scan.depth_scale=10000" if is_millimetres else "",
            scale=frames[0].depth_scale,
        )
    )
    return replace(scan, frames=frames)


def are_rotated(files: Sequence[Path], *, is_scale_stated: bool) -> bool:
    """Detect rotated bits in depth files, judged by two of them.

    See `is_rotated`.
    """
    with only_looking():
        maps = [_raw_or_none(path) for path in files[:: max(1, len(files) // _LOOKED_AT)][:_LOOKED_AT]]
    found = [raw for raw in maps if raw is not None]
    return bool(found) and all(is_rotated(raw, is_scale_stated=is_scale_stated) for raw in found)


def _raw_or_none(path: Path) -> NDArray[np.uint16] | None:
    try:
        raw = read_raw_depth(path)
    except InputError:
        return None
    return raw if raw.dtype == np.uint16 else None


def _jumps(values: NDArray[np.uint16], known: NDArray[np.bool_]) -> float:
    """Return the ratio of adjacent valid pixels whose values differ by a jump.

    Only horizontal neighbours are compared.
    """
    both = known[:, 1:] & known[:, :-1]
    steps = np.abs(np.diff(values.astype(np.int32), axis=1))[both]
    return float(np.mean(steps > _JUMP)) if steps.size else 1.0
