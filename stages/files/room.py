"""Check of available memory, to tell lack of memory from a damaged file."""

from __future__ import annotations

import numpy as np

# Bytes for small allocations: decoder tables, exceptions.
_LITTLE = 1 << 24


def require_room(size: int = 0) -> None:
    """Check that `size` bytes can be allocated.

    Decoders often report lack of memory as a damaged file. Callers check memory before they report damage.

    Raises
    ------
    MemoryError
        If the allocation fails.
    """
    np.empty(size + _LITTLE, np.uint8)
