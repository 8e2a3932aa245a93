"""The buffers of OpenBLAS, which multiplies matrices for NumPy.

Every thread takes one when it first multiplies, and where there is no room for it OpenBLAS ends the process,
or waits for ever: room is looked for, and the buffers are taken, before there is work to lose.
"""

from __future__ import annotations

import mmap
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

# What a thread takes: a buffer of OpenBLAS 0.3 is 32 MiB, its stack 8 MiB; the rest is for matrices.
_THREAD_BYTES = 44 << 20
# Rows of a matrix whose square takes long enough for all threads to be at it together.
_ROWS = 400

_lock = threading.Lock()
_taken = 0


def require_buffers(threads: int) -> None:
    """Let so many threads multiply at a time.

    Raises
    ------
    MemoryError
        If there is no room for their buffers.
    """
    global _taken
    with _lock:
        if threads <= _taken:
            return
        try:
            mmap.mmap(-1, (threads - _taken) * _THREAD_BYTES).close()
        except OSError as error:
            raise MemoryError from error
        factor = np.eye(_ROWS)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(factor.dot, [factor] * threads))
        _taken = threads
