"""Named arrays in one `.npz` file, read without trusting its headers."""

from __future__ import annotations

import json
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.input_files import open_input
from scanloom.stages.files.memory_check import check_memory_available
from scanloom.stages.files.zip_archives import has_bounded_size
from scanloom.stages.simplification.codes import SIMPLIFY_RECORD_INVALID

Arrays = dict[str, NDArray[Any]]

# Exceptions that damaged archives cause. RuntimeError is raised for encrypted entries, the last line for
# array headers that are not valid Python.
_DAMAGE_ERRORS = (
    *(
        ValueError,
        KeyError,
        EOFError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
        struct.error,
    ),
    *(SyntaxError, tokenize.TokenError, TypeError, IndexError, AttributeError, OverflowError),
)
# Maximum ratio of unpacked to file size. Records are uncompressed, and recompressing them saves a half to two
# thirds. The limit allows grids of equal numbers, and rejects zip bombs.
_MAX_UNPACK_RATIO = 32
# NumPy dtype kinds: integers, floats, booleans and text.
_DTYPE_KINDS = "iufbU"


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays to a file, atomically.

    Raises
    ------
    StageError
        If the file cannot be written.
    """
    with write_file_atomically(path) as part, part.open("wb") as file:
        # `savez` has parameters of other types than arrays, hence the annotation.
        named: dict[str, Any] = dict(arrays)
        np.savez(file, **named)


def read_arrays(path: Path) -> Arrays:
    """Read the arrays of a file.

    Raises
    ------
    InputError
        If the file is missing, damaged or no array archive, or declares more data than it can contain.
    """
    try:
        with open_input(path) as file, zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if sum(entry.file_size for entry in entries) > _MAX_UNPACK_RATIO * path.stat().st_size:
                raise InputError(
                    SIMPLIFY_RECORD_INVALID,
                    "is not a collapse record: it would unpack to many times its size.",
                    path,
                )
            return {entry.filename.removesuffix(".npy"): _read_array(archive, entry) for entry in entries}
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {detail}.", path, detail=error.strerror or error
        ) from error
    except _DAMAGE_ERRORS as error:
        raise InputError(SIMPLIFY_RECORD_INVALID, "is damaged, or not a collapse record.", path) from error


def parse_json_object(text: NDArray[Any]) -> dict[str, Any]:
    """Parse a JSON object from a text array.

    Raises
    ------
    ValueError, RecursionError
        If the text is not valid JSON, or not an object.
    """
    value = json.loads(str(text)) if text.dtype.kind == "U" and not text.shape else None
    if not isinstance(value, dict):
        raise ValueError("the metadata is not a JSON object")
    return value


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    if not has_bounded_size(entry):
        raise ValueError
    with archive.open(entry) as content:
        _require_declared_size(content, entry.file_size)
    # Reopen the entry: zipfile verifies the checksum only when reading from start to end.
    with archive.open(entry) as content:
        array: NDArray[Any] = np.lib.format.read_array(content, allow_pickle=False)
    # Compiled code requires booleans to be 0 or 1.
    return array.view(np.uint8) != 0 if array.dtype.kind == "b" else array


def _require_declared_size(content: IO[bytes], size: int) -> None:
    """Reject array headers that declare more data than follows, before allocating it."""
    version = np.lib.format.read_magic(content)
    read_header = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read_header = np.lib.format.read_array_header_2_0
    try:
        shape, _, dtype = read_header(content)
    except MemoryError as error:
        check_memory_available()
        # Python also raises MemoryError for deeply nested brackets in the short header.
        raise ValueError from error
    # An array without elements could still declare an enormous number of rows.
    max_size = max(math.prod(shape) * dtype.itemsize, *shape, 0)
    if dtype.kind not in _DTYPE_KINDS or not dtype.itemsize or max_size > size:
        raise ValueError
