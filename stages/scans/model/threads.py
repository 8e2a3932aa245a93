"""How many threads work on one thing: all cores, or what is said where several processes share a machine."""

from __future__ import annotations

import os
from collections.abc import Mapping

# Read by the kernels, too (`kernels/src/base/parallel.rs`).
VARIABLE = "SCANLOOM_THREADS"
# What libraries read when they are loaded: OpenMP (Open3D), OpenBLAS (NumPy), MKL, OpenCV.
_OF_LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")


def threads_to_use() -> int:
    """Return how many threads to use if no parameter says it: $SCANLOOM_THREADS, else one for each core."""
    said = os.environ.get(VARIABLE, "")
    return int(said) if said.isascii() and said.isdigit() and int(said) > 0 else os.cpu_count() or 1


def environment_of(threads: int) -> Mapping[str, str]:
    """Return what to set in the environment of a process that is to use so many threads."""
    return dict.fromkeys((VARIABLE, *_OF_LIBRARIES), str(threads))
