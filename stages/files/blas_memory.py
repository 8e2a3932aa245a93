"""Preallocation of the buffers of OpenBLAS, NumPy's matrix library.

Each thread allocates a buffer on its first matrix product. If the allocation fails, OpenBLAS aborts the
process or hangs. So memory is checked and the buffers are allocated before there are results to lose.
"""

from __future__ import annotations

import mmap
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

# Bytes per thread: 32 MiB buffer (OpenBLAS 0.3), 8 MiB stack, and 4 MiB for matrices.
_THREAD_BYTES = 44 << 20
# Matrix rows; a product of this size takes long enough that all threads run at the same time.
_MATRIX_ROWS = 400

_lock = threading.Lock()
_reserved_threads = 0


def reserve_blas_buffers(threads: int) -> None:
    """Allocate OpenBLAS buffers for a number of concurrent threads.

    Raises
    ------
    MemoryError
        If there is too little memory for the buffers.
    """
    global _reserved_threads
    with _lock:
        if threads <= _reserved_threads:
            return
        try:
            mmap.mmap(-1, (threads - _reserved_threads) * _THREAD_BYTES).close()
        except OSError as error:
            raise MemoryError from error
        factor = np.eye(_MATRIX_ROWS)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(factor.dot, [factor] * threads))
        _reserved_threads = threads
