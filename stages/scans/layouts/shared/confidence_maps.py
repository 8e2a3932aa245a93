"""Confidence maps in a separate folder next to the depth maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.file_access_log import pause_recording
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.scans.codes import SCAN_CONFIDENCE
from scanloom.stages.scans.image_folders.image_files import extract_numbers, find_first_existing, list_images
from scanloom.stages.scans.layouts.shared.phone_scans import resolve_min_confidence
from scanloom.stages.scans.model.reading_params import ReadingParams

_CONFIDENCE_FOLDERS = ("confidence", "conf", "confidences")
_SAMPLE_COUNT = 4
# Apps write low, medium and high as 0, 1, 2 or other values. More distinct values are a continuous measure.
_MAX_LEVEL_COUNT = 8


def find_confidence_maps(
    folder: Path, depths: Sequence[Path], options: ReadingParams
) -> tuple[Mapping[Path, Path], int]:
    """Return the confidence map of each depth map, and the minimum confidence.

    By default, only the lowest level is discarded; without discrete levels, nothing is.
    """
    confidence_folder = find_first_existing(folder, *_CONFIDENCE_FOLDERS)
    if confidence_folder is None or not confidence_folder.is_dir():
        return {}, 0
    by_number = {extract_numbers(path.stem) or path.stem: path for path in list_images(confidence_folder)}
    found = {
        depth: by_number[key]
        for depth in depths
        if (key := extract_numbers(depth.stem) or depth.stem) in by_number
    }
    if not found:
        emit(
            SCAN_CONFIDENCE.warning(
                "the numbers of the images in {folder}/ match no depth map: the confidence maps are ignored",
                folder=confidence_folder.name,
            )
        )
        return {}, 0
    levels = _sample_levels(list(found.values()))
    if 1 < len(levels) <= _MAX_LEVEL_COUNT:
        return found, resolve_min_confidence(options, levels, folder)
    if options.min_confidence is not None:
        return found, options.min_confidence
    if levels:
        emit(
            SCAN_CONFIDENCE.warning(
                "{folder}/ contains continuous depth confidence from {lowest} to {highest}: set "
                "scan.min_confidence=VALUE to ignore depth below a confidence",
                folder=confidence_folder.name,
                lowest=levels[0],
                highest=levels[-1],
            )
        )
    else:
        emit(
            SCAN_CONFIDENCE.warning(
                "{folder}/ does not contain 8-bit confidence maps: it is ignored",
                folder=confidence_folder.name,
            )
        )
    return {}, 0


def _sample_levels(files: Sequence[Path]) -> list[int]:
    """Return the sorted values of a sample of 8-bit maps.

    Empty if the maps are not 8-bit.
    """
    found: set[int] = set()
    with pause_recording():
        for path in files[:: max(1, len(files) // _SAMPLE_COUNT)][:_SAMPLE_COUNT]:
            found |= _read_values(path)
    return sorted(found)


def _read_values(path: Path) -> set[int]:
    try:
        stored = read_stored_image(path)
    except InputError:
        return set()
    return set(np.unique(stored).tolist()) if stored.dtype == np.uint8 and stored.ndim == 2 else set()
