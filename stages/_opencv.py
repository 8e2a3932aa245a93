"""Memory check before the import of OpenCV, which aborts the process if memory runs out."""

from __future__ import annotations

import mmap
import os
import sys

# Address space in bytes: OpenCV's libraries, and one stack for each thread of its OpenBLAS.
_LIBRARY_BYTES = 400 << 20
_STACK_BYTES = 8 << 20


def require_opencv() -> None:
    """Check that enough memory is available to import OpenCV.

    Does nothing if OpenCV is already imported.

    Raises
    ------
    MemoryError
        If there is too little memory.
    """
    if "cv2" in sys.modules:
        return
    try:
        mmap.mmap(-1, _LIBRARY_BYTES + _STACK_BYTES * (os.cpu_count() or 1)).close()
    except OSError as error:
        raise MemoryError from error
