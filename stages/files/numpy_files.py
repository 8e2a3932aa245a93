"""NumPy's files of one array, opened by any thread."""

from __future__ import annotations

import math
import tokenize
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.files.opening import require_regular

# Their headers are parsed as Python's own text is, which CPython 3.11 now and then fails at where two threads
# do so at once (python/cpython#106905).
_PARSING = Lock()
# What numpy raises for damaged headers, which it parses as Python: MemoryError for signs upon signs.
NPY_FAULTS = (
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


def mapped(path: Path) -> NDArray[Any]:
    """Return the array of a .npy file, which stays on disk; a header that promises more than it holds fails.

    Raises
    ------
    OSError, ValueError, EOFError
        As NumPy does, or another of NPY_FAULTS.
    """
    with _PARSING:
        array: NDArray[Any] = np.load(require_regular(path), mmap_mode="r", allow_pickle=False)
    return array


def array_of(content: BytesIO) -> NDArray[Any]:
    """Return the array of a .npy file's content; none is made that is larger than what there is.

    Raises
    ------
    ValueError
        If the content is none, holds objects, or is shorter than its header says; or another of NPY_FAULTS.
    """
    with _PARSING:
        version = np.lib.format.read_magic(content)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, in_columns, dtype = read(content)
    left = content.getbuffer()[content.tell() :]
    if dtype.hasobject or math.prod(shape) * dtype.itemsize > len(left):
        raise ValueError("the array is cut short, or holds objects")
    array: NDArray[Any] = np.frombuffer(left, dtype, math.prod(shape)).reshape(
        shape, order="F" if in_columns else "C"
    )
    return array
