"""Thread-safe readers for .npy files."""

from __future__ import annotations

import math
import tokenize
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.files.input_files import require_regular_file

# NumPy parses headers with Python's parser, which in CPython 3.11 occasionally fails when two threads use it
# at once (python/cpython#106905).
_PARSER_LOCK = Lock()
# Exceptions that NumPy raises for damaged headers, which it parses as Python code. MemoryError comes from
# deeply nested operators.
NPY_ERRORS = (
    OSError,
    ValueError,
    EOFError,
    TypeError,
    OverflowError,
    MemoryError,
    RecursionError,
    SyntaxError,
    tokenize.TokenError,
)


def map_array(path: Path) -> NDArray[Any]:
    """Memory-map the array of a .npy file.

    Raises
    ------
    OSError, ValueError, EOFError
        As NumPy; or another of NPY_ERRORS. A header that states more data than the file holds raises
        ValueError.
    """
    with _PARSER_LOCK:
        array: NDArray[Any] = np.load(require_regular_file(path), mmap_mode="r", allow_pickle=False)
    return array


def parse_array(content: BytesIO) -> NDArray[Any]:
    """Parse the content of a .npy file without copying the data.

    Raises
    ------
    ValueError
        If the content is not a .npy file, holds objects, or is shorter than its header states; or another of
        NPY_ERRORS.
    """
    shape, in_columns, dtype = parse_array_header(content)
    left = content.getbuffer()[content.tell() :]
    if dtype.hasobject or math.prod(shape) * dtype.itemsize > len(left):
        raise ValueError("the array is cut short, or holds objects")
    array: NDArray[Any] = np.frombuffer(left, dtype, math.prod(shape)).reshape(
        shape, order="F" if in_columns else "C"
    )
    return array


def parse_array_header(content: BytesIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Parse the header of a .npy file, and leave the position at its end.

    Returns
    -------
    Shape, True for Fortran order, and data type.

    Raises
    ------
    ValueError
        If the content is not a .npy file; or another of NPY_ERRORS.
    """
    with _PARSER_LOCK:
        version = np.lib.format.read_magic(content)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, in_columns, dtype = read(content)
    return shape, in_columns, dtype
