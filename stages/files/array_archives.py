"""Arrays of a `.npz` archive from an untrusted source, read one item at a time.

Stored arrays are mapped. Deflated arrays cannot be read from the middle, so they are unpacked once and kept.
"""

from __future__ import annotations

import math
import struct
import zipfile
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_ARCHIVE_DAMAGED
from scanloom.stages.files.memory_check import check_memory_available
from scanloom.stages.files.numpy_files import NPY_ERRORS, parse_array, parse_array_header
from scanloom.stages.files.zip_archives import ARCHIVE_ERRORS, has_bounded_size, open_archive, read_entry

# Maximum ratio of the size of an array to that of the archive. Depth maps compress two to ten times, zeros a
# thousand times.
_MAX_UNPACK_RATIO = 128
# Unpacked arrays that are kept: depth, confidence and images of one scan.
_MAX_KEPT_ARRAYS = 3
# Maximum bytes of a .npy header.
_MAX_HEADER_BYTES = 1 << 16
_LOCAL_HEADER = struct.Struct("<4s22xHH")


@dataclass(frozen=True)
class ArchivedArray:
    """Array of an archive whose items are read on demand.

    Attributes
    ----------
    path : the archive.
    entry : name of the entry in the archive.
    shape : of the whole array.
    kind : NumPy's letter for the type: "f" for floats, "i" and "u" for integers.
    """

    path: Path
    entry: str
    shape: tuple[int, ...]
    kind: str

    def read(self) -> NDArray[Any]:
        """Return the whole array, read-only.

        Raises
        ------
        InputError
            If the archive is damaged, or has changed since it was opened.
        """
        stamp = self.path.stat()
        array = _read_array(self.path, self.entry, (stamp.st_mtime_ns, stamp.st_size))
        if array.shape != self.shape or array.dtype.kind != self.kind:
            raise _create_damage_error(self.path, self.entry)
        return array


def list_arrays(path: Path) -> dict[str, ArchivedArray]:
    """List the numeric arrays of an archive by name, without reading them.

    Raises
    ------
    InputError
        If the archive cannot be opened.
    """
    found = {}
    with open_archive(path) as archive:
        for entry in archive.infolist():
            if not entry.filename.endswith(".npy") or not has_bounded_size(entry):
                continue
            try:
                with archive.open(entry) as content:
                    start = BytesIO(content.read(min(entry.file_size, _MAX_HEADER_BYTES)))
                shape, _, dtype = parse_array_header(start)
            except (*ARCHIVE_ERRORS, *NPY_ERRORS):
                continue
            is_whole = math.prod(shape) * dtype.itemsize + start.tell() == entry.file_size
            if dtype.kind in "iuf" and is_whole:
                name = entry.filename.removesuffix(".npy")
                found[name] = ArchivedArray(path, entry.filename, shape, dtype.kind)
    return found


@lru_cache(maxsize=_MAX_KEPT_ARRAYS)
def _read_array(path: Path, name: str, stamp: tuple[int, int]) -> NDArray[Any]:  # noqa: ARG001 (part of the key)
    with open_archive(path) as archive:
        entry = archive.getinfo(name)
        try:
            if entry.compress_type == zipfile.ZIP_STORED:
                return _map_array(path, entry)
            return _unpack_array(archive, entry, path)
        except (*ARCHIVE_ERRORS, *NPY_ERRORS) as error:
            check_memory_available(entry.file_size)
            raise _create_damage_error(path, name) from error


def _map_array(path: Path, entry: zipfile.ZipInfo) -> NDArray[Any]:
    """Map a stored array, whose data follow a header in the archive and one of NumPy's."""
    with path.open("rb") as file:
        file.seek(entry.header_offset)
        mark, name_length, extra_length = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
        if mark != b"PK\x03\x04":
            raise ValueError("no entry starts here")
        begin = entry.header_offset + _LOCAL_HEADER.size + name_length + extra_length
        file.seek(begin)
        start = BytesIO(file.read(min(entry.file_size, _MAX_HEADER_BYTES)))
    shape, in_columns, dtype = parse_array_header(start)
    return np.memmap(path, dtype, "r", begin + start.tell(), shape, "F" if in_columns else "C")


def _unpack_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> NDArray[Any]:
    max_bytes = _MAX_UNPACK_RATIO * path.stat().st_size
    check_memory_available(min(entry.file_size, max_bytes))
    return parse_array(BytesIO(read_entry(archive, entry.filename, path, max_bytes)))


def _create_damage_error(path: Path, name: str) -> InputError:
    return InputError(
        FILE_ARCHIVE_DAMAGED, "{name} cannot be read from the archive; it is damaged.", path, name=name
    )
