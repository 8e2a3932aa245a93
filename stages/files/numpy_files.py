"""NumPy's files of one array, opened by any thread."""

from __future__ import annotations

from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.files.opening import require_regular

# Their headers are parsed as Python's own text is, which CPython 3.11 now and then fails at where two threads
# do so at once (python/cpython#106905).
_PARSING = Lock()


def mapped(path: Path) -> NDArray[Any]:
    """Return the array of a .npy file, which stays on disk; a header that promises more than it holds fails.

    Raises
    ------
    OSError, ValueError, EOFError
        As NumPy does.
    """
    with _PARSING:
        array: NDArray[Any] = np.load(require_regular(path), mmap_mode="r", allow_pickle=False)
    return array
