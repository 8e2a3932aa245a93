"""Check of available memory, to tell lack of memory from a damaged file."""

from __future__ import annotations

import numpy as np

# Bytes for small allocations: decoder tables, exceptions.
_SMALL_ALLOCATIONS_BYTES = 1 << 24


def check_memory_available(size: int = 0) -> None:
    """Check that `size` bytes can be allocated.

    Decoders often report lack of memory as a damaged file. Callers check memory before they report damage.

    Raises
    ------
    MemoryError
        If the allocation fails.
    """
    np.empty(size + _SMALL_ALLOCATIONS_BYTES, np.uint8)
