"""Calibrations as NumPy archives: `np.savez("calibration.npz", mtx=…, dist=…)`."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.numpy_files import NPY_ERRORS, parse_array
from scanloom.stages.files.zip_archives import open_archive, read_entry
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID

# Bytes of an array; larger ones are detected board corners, which are often saved with the cameras.
_MAX_ARRAY_BYTES = 1 << 20
_MAX_ARRAYS = 1 << 10
# Maximum elements of an array with intrinsics, distortion or extrinsics.
_MAX_ELEMENTS = 64


def read_small_arrays(path: Path) -> dict[str, Any]:
    """Read the small arrays of a .npz archive by name.

    Arrays become nested lists; arrays of one element become a number or string.

    Raises
    ------
    InputError
        If the archive is damaged, or holds no small array.
    """
    found: dict[str, Any] = {}
    with open_archive(path) as archive:
        for entry in archive.infolist()[:_MAX_ARRAYS]:
            if not entry.filename.endswith(".npy") or entry.file_size > _MAX_ARRAY_BYTES:
                continue
            try:
                array = parse_array(BytesIO(read_entry(archive, entry.filename, path, _MAX_ARRAY_BYTES)))
            except NPY_ERRORS:
                # Object arrays hold for example board corners of varying count, never cameras.
                continue
            if array.size <= _MAX_ELEMENTS and array.dtype.kind in "uifbU":
                found[entry.filename.removesuffix(".npy")] = array.tolist()
    if not found:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "it contains no numeric array that is small enough for a calibration.",
            path,
        )
    return found
