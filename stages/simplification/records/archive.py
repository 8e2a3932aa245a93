"""Arrays by name in one file, as `numpy.savez` writes them; read without trusting what the file promises."""

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
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.opening import opened
from scanloom.stages.files.replacing import replacing
from scanloom.stages.files.room import require_room
from scanloom.stages.files.zip_archives import is_bounded
from scanloom.stages.simplification.codes import SIMPLIFY_RECORD_INVALID

Arrays = dict[str, NDArray[Any]]

# What reading an archive can raise; RuntimeError is for an encryption nobody asked for, and the last line for
# an array whose first lines are no Python.
_DAMAGE = (
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
# Records are written as they are. One that somebody packed again shrinks to a half or a third; the limit
# leaves room for grids of equal numbers, and none for a file that unpacks a thousandfold.
_MOST_UNPACKED = 32
# Whole numbers, real numbers, truth values and text.
_KINDS = "iufbU"


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays to a file, whole or not at all.

    Raises
    ------
    StageError
        If the system refuses to write.
    """
    with replacing(path) as part, part.open("wb") as file:
        # What numpy's own arguments are called is the reason for the type.
        named: dict[str, Any] = dict(arrays)
        np.savez(file, **named)


def read_arrays(path: Path) -> Arrays:
    """Return the arrays of a file.

    Raises
    ------
    InputError
        If the file is missing, no archive of arrays, damaged, or promises more than it can hold.
    """
    try:
        with opened(path) as file, zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if sum(entry.file_size for entry in entries) > _MOST_UNPACKED * path.stat().st_size:
                raise InputError(
                    SIMPLIFY_RECORD_INVALID,
                    "is no record of collapses: it would unpack to far more than it is.",
                    path,
                )
            return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {detail}.", path, detail=error.strerror or error
        ) from error
    except _DAMAGE as error:
        raise InputError(SIMPLIFY_RECORD_INVALID, "is damaged, or no record of collapses.", path) from error


def json_object(text: NDArray[Any]) -> dict[str, Any]:
    """Return what the JSON of a text says.

    Raises
    ------
    ValueError, RecursionError
        If it is no JSON, or no object.
    """
    words = json.loads(str(text)) if text.dtype.kind == "U" and not text.shape else None
    if not isinstance(words, dict):
        raise ValueError("a text is no JSON object")
    return words


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    if not is_bounded(entry):
        raise ValueError
    with archive.open(entry) as content:
        _require_true_size(content, entry.file_size)
    # From the start again: only what is read from start to end has its checksum looked at.
    with archive.open(entry) as content:
        array: NDArray[Any] = np.lib.format.read_array(content, allow_pickle=False)
    # Any other byte than 0 and 1 is no truth value to compiled code.
    return array.view(np.uint8) != 0 if array.dtype.kind == "b" else array


def _require_true_size(content: IO[bytes], size: int) -> None:
    """Refuse an array whose first lines promise more numbers than follow, before there is room for them."""
    version = np.lib.format.read_magic(content)
    read_header = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read_header = np.lib.format.read_array_header_2_0
    try:
        shape, _, dtype = read_header(content)
    except MemoryError as error:
        require_room()
        # What Python says of brackets in brackets in brackets; the lines themselves are short.
        raise ValueError from error
    # An empty array, too, could be said to have more rows than anybody has room for.
    most = max(math.prod(shape) * dtype.itemsize, *shape, 0)
    if dtype.kind not in _KINDS or not dtype.itemsize or most > size:
        raise ValueError
