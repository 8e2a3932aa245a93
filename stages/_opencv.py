"""Room for OpenCV: its import ends the process where there is too little for it."""

from __future__ import annotations

import mmap
import os
import sys

# Of address space: its libraries, and a stack for each thread of the OpenBLAS it brings.
_LIBRARY_BYTES = 400 << 20
_STACK_BYTES = 8 << 20


def require_opencv() -> None:
    """Look for room for the import of OpenCV, where it is the first.

    Raises
    ------
    MemoryError
        If there is none.
    """
    if "cv2" in sys.modules:
        return
    try:
        mmap.mmap(-1, _LIBRARY_BYTES + _STACK_BYTES * (os.cpu_count() or 1)).close()
    except OSError as error:
        raise MemoryError from error
