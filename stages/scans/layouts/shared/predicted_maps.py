"""Depth and confidence maps that a network predicted, one `.npy` file per view or from an archive."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_array
from scanloom.stages.scans.codes import SCAN_CONFIDENCE, SCAN_PREDICTION_INVALID
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import PackedImage

# Confidence is 1 + exp(x) in most networks. An 8-bit map stores its logarithm, in steps of 4 %.
_LEVELS_PER_DOUBLING = 16
# Depth is dropped if its confidence is below this ratio of the median.
_MIN_CONFIDENCE_RATIO = 1 / 3
_SAMPLED_VIEWS = 16


def create_shape_error(path: Path, name: str, found: str, expected: str) -> InputError:
    """Create the error for an array of another shape, or a missing one."""
    return InputError(
        SCAN_PREDICTION_INVALID,
        "the array {array} is {found}; {expected} is expected.",
        path,
        array=name.removesuffix(".npy"),
        found=found,
        expected=expected,
    )


def read_map(path: Path, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Read a map (h, w) of a `.npy` file.

    Raises
    ------
    InputError
        If the file is damaged, or has another shape.
    """
    array = read_array(path, "the map")
    if array.shape not in (shape, (*shape, 1), (1, *shape)) or array.dtype.kind not in "fiu":
        raise create_shape_error(path, path.stem, str(array.shape), str(shape))
    # Values beyond single precision become infinite, which is missing depth.
    with np.errstate(over="ignore"):
        return np.array(array.reshape(shape), np.float32)


def read_levels(path: Path, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Read the confidence map of a `.npy` file; see `to_confidence_levels` and `read_map`."""
    return to_confidence_levels(read_map(path, shape))


def to_confidence_levels(confidence: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert the confidence of a network to 8 bits: its logarithm, 0 for 1 and less."""
    levels = _LEVELS_PER_DOUBLING * np.log2(np.maximum(np.nan_to_num(confidence, nan=0.0), 1.0))
    return np.asarray(levels.clip(0, 255), np.uint8)


def choose_min_confidence(maps: Sequence[PackedImage] | None, options: ReadingParams) -> int:
    """Return the level of confidence below which depth is dropped, and report it.

    By default it is a third of the median confidence.
    """
    if options.min_confidence is not None or not maps:
        return options.min_confidence or 0
    levels = np.concatenate([one.load().ravel() for one in maps[:: max(1, len(maps) // _SAMPLED_VIEWS)]])
    least = int(max(0, np.median(levels) + _LEVELS_PER_DOUBLING * np.log2(_MIN_CONFIDENCE_RATIO)))
    emit(
        SCAN_CONFIDENCE.info(
            "depth with less than a third of the median confidence is dropped ({dropped:.0%}, level "
            "{least}): scan.min_confidence=LEVEL sets another limit, {step} levels for each doubling of the "
            "confidence",
            dropped=float(np.mean(levels < least)),
            least=least,
            step=_LEVELS_PER_DOUBLING,
        )
    )
    return least
