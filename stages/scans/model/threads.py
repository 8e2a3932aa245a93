"""Number of threads per process, limited when several processes share a machine."""

from __future__ import annotations

import os
from collections.abc import Mapping

# Also read by the kernels (`kernels/src/base/parallel.rs`).
THREADS_VARIABLE = "SCANLOOM_THREADS"
# Environment variables that libraries read on import: OpenMP (Open3D), OpenBLAS (NumPy), MKL, OpenCV.
_LIBRARY_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")


def get_thread_count() -> int:
    """Return the default number of threads: $SCANLOOM_THREADS, or the core count."""
    value = os.environ.get(THREADS_VARIABLE, "")
    return int(value) if value.isascii() and value.isdigit() and int(value) > 0 else os.cpu_count() or 1


def build_thread_environment(threads: int) -> Mapping[str, str]:
    """Return environment variables that limit a subprocess to a number of threads."""
    return dict.fromkeys((THREADS_VARIABLE, *_LIBRARY_VARIABLES), str(threads))
