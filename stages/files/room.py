"""Whether it was memory that ran out, where a decoder only says that something failed."""

from __future__ import annotations

import numpy as np

# What little things take: a decoder's tables, an exception.
_LITTLE = 1 << 24


def require_room(size: int = 0) -> None:
    """Ask for as much memory as something of `size` bytes takes, before its failure is called damage.

    Raises
    ------
    MemoryError
        If there is no room for it.
    """
    np.empty(size + _LITTLE, np.uint8)
