"""Depth maps whose bits are rotated left by three, as SUN3D, SUN RGB-D and their relatives store them.

They are known by what they hold: a depth of less than 8192 is a multiple of eight, and where it grows beyond,
the stored values start again from 0. Turned back, neighbouring pixels are as near to each other as they were.
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
# The unit of the APC toolbox. Who states it means the values turned back: hardly a sensor has steps of eight.
_TENTHS_OF_MILLIMETRES = 10000.0
# Fewer pixels, or fewer values, are no depth map that says how it is stored.
_LEAST_PIXELS = 1000
_LEAST_VALUES = 64
# Values between neighbouring pixels that are a jump. Of plain values turned back, nearly all neighbours jump.
_JUMP = 1 << 12
_MOST_JUMPS = 0.05
# Turned values that are odd, at least: multiples of 16 and more are rounded for another reason.
_LEAST_ODD = 0.2
# Plain values that happen to be multiples of eight, by noise, at most.
_MOST_PLAIN = 0.001


def turned_back(raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return depth values (h, w) with their bits rotated right by three."""
    return np.asarray((raw >> 3) | (raw << 13), np.uint16)


def read_turned_back(path: Path) -> NDArray[np.uint16]:
    """Return a depth file's values with their bits turned back; raises InputError if it has no 16 bits."""
    raw = read_raw_depth(path)
    if raw.dtype != np.uint16:
        raise InputError(FILE_DEPTH_FORMAT, "depth of 16 bits is expected.", path)
    return turned_back(raw)


def is_rotated(raw: NDArray[np.uint16], *, is_scale_stated: bool) -> bool:
    """Say whether the bits of a depth map (h, w) are rotated.

    Parameters
    ----------
    is_scale_stated : the person says what a unit is: multiples of eight may then be what they mean.
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
    """Return the scan with its depth maps turned back where their bits are rotated, with a warning.

    Parameters
    ----------
    stated : units a metre, as the person states them.
    is_own : it is in our own form, whose unit is taken at its word.
    """
    files = [frame.depth for frame in scan.frames if isinstance(frame.depth, Path)]
    # Rotated values are millimetres or tenths of them: of other units somebody said what they are.
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
            "the bits of the depth maps are rotated by three, as SUN3D stores them: they are turned back, "
            "and {scale:g} units are then a metre",
            remedy="set scan.depth_scale=10000 where they are tenths of millimetres"
            if is_millimetres
            else "",
            scale=frames[0].depth_scale,
        )
    )
    return replace(scan, frames=frames)


def are_rotated(files: Sequence[Path], *, is_scale_stated: bool) -> bool:
    """Say whether the bits of depth files are rotated, by two of them; see `is_rotated`."""
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
    """Return the share of neighbours in a row, both known, that are a jump apart."""
    both = known[:, 1:] & known[:, :-1]
    steps = np.abs(np.diff(values.astype(np.int32), axis=1))[both]
    return float(np.mean(steps > _JUMP)) if steps.size else 1.0
