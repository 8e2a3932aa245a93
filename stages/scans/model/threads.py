"""Number of threads per process, limited when several processes share a machine."""

from __future__ import annotations

import os
from collections.abc import Mapping

# Also read by the kernels (`kernels/src/base/parallel.rs`).
VARIABLE = "SCANLOOM_THREADS"
# Environment variables that libraries read on import: OpenMP (Open3D), OpenBLAS (NumPy), MKL, OpenCV.
_OF_LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")


def threads_to_use() -> int:
    """Return the default number of threads: $SCANLOOM_THREADS, or the core count."""
    said = os.environ.get(VARIABLE, "")
    return int(said) if said.isascii() and said.isdigit() and int(said) > 0 else os.cpu_count() or 1


def environment_of(threads: int) -> Mapping[str, str]:
    """Return environment variables that limit a subprocess to a number of threads."""
    return dict.fromkeys((VARIABLE, *_OF_LIBRARIES), str(threads))
