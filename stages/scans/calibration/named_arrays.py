"""Calibrations as NumPy's archives of arrays: `np.savez("calibration.npz", mtx=…, dist=…)`."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.numpy_files import NPY_FAULTS, array_of
from scanloom.stages.files.zip_archives import entry_content, opened_archive
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID

# Of an array; boards seen in a hundred images, which lie beside the cameras, are more.
_MOST_BYTES = 1 << 20
_MOST_ARRAYS = 1 << 10
# Of the numbers of a camera or of how two stand to each other.
_MOST_NUMBERS = 64


def tables(path: Path) -> dict[str, Any]:
    """Return the small arrays of an archive by name: nested rows, or a number or word where it holds one.

    Raises
    ------
    InputError
        If the archive is damaged, or holds no such array.
    """
    found: dict[str, Any] = {}
    with opened_archive(path) as archive:
        for entry in archive.infolist()[:_MOST_ARRAYS]:
            if not entry.filename.endswith(".npy") or entry.file_size > _MOST_BYTES:
                continue
            try:
                array = array_of(BytesIO(entry_content(archive, entry.filename, path, _MOST_BYTES)))
            except NPY_FAULTS:
                # Objects, as of boards with unlike counts of corners: they are nothing of a camera.
                continue
            if array.size <= _MOST_NUMBERS and array.dtype.kind in "uifbU":
                found[entry.filename.removesuffix(".npy")] = array.tolist()
    if not found:
        raise InputError(CAMERA_CALIBRATION_INVALID, "no small array of numbers is in it.", path)
    return found
