"""Confidence maps in a separate folder next to the depth maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_stored
from scanloom.stages.files.noting import only_looking
from scanloom.stages.scans.codes import SCAN_CONFIDENCE
from scanloom.stages.scans.image_folders.image_files import first_existing, images, numbers
from scanloom.stages.scans.layouts.shared.phones import least_confidence
from scanloom.stages.scans.model.reading_params import ReadingParams

_FOLDERS = ("confidence", "conf", "confidences")
_LOOKED_AT = 4
# Apps write low, medium and high as 0, 1, 2 or other values. More distinct values are a continuous measure.
_MOST_LEVELS = 8


def confidence_of(
    folder: Path, depths: Sequence[Path], options: ReadingParams
) -> tuple[Mapping[Path, Path], int]:
    """Return the confidence map of each depth map, and the minimum confidence.

    By default, only the lowest level is discarded; without discrete levels, nothing is.
    """
    place = first_existing(folder, *_FOLDERS)
    if place is None or not place.is_dir():
        return {}, 0
    by_number = {numbers(path.stem) or path.stem: path for path in images(place)}
    found = {
        depth: by_number[key] for depth in depths if (key := numbers(depth.stem) or depth.stem) in by_number
    }
    if not found:
        emit(
            SCAN_CONFIDENCE.warning(
                "the numbers of the images in {folder}/ match no depth map: the confidence maps are ignored",
                folder=place.name,
            )
        )
        return {}, 0
    levels = _levels(list(found.values()))
    if 1 < len(levels) <= _MOST_LEVELS:
        return found, least_confidence(options, levels, folder)
    if options.least_confidence is not None:
        return found, options.least_confidence
    if levels:
        emit(
            SCAN_CONFIDENCE.warning(
                "{folder}/ contains continuous depth confidence from {lowest} to {highest}: set "
                "scan.least_confidence=VALUE to ignore depth below a confidence",
                folder=place.name,
                lowest=levels[0],
                highest=levels[-1],
            )
        )
    else:
        emit(
            SCAN_CONFIDENCE.warning(
                "{folder}/ does not contain 8-bit confidence maps: it is ignored", folder=place.name
            )
        )
    return {}, 0


def _levels(files: Sequence[Path]) -> list[int]:
    """Return the sorted values of a sample of 8-bit maps.

    Empty if the maps are not 8-bit.
    """
    found: set[int] = set()
    with only_looking():
        for path in files[:: max(1, len(files) // _LOOKED_AT)][:_LOOKED_AT]:
            found |= _values(path)
    return sorted(found)


def _values(path: Path) -> set[int]:
    try:
        stored = read_stored(path)
    except InputError:
        return set()
    return set(np.unique(stored).tolist()) if stored.dtype == np.uint8 and stored.ndim == 2 else set()
