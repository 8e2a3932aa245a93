"""What Windows tells of itself."""

from __future__ import annotations

import ctypes
import sys

# For type checkers: what follows is not there elsewhere.
assert sys.platform == "win32"


class _MemoryStatus(ctypes.Structure):
    """MEMORYSTATUSEX."""

    _fields_ = (
        ("length", ctypes.c_uint32),
        ("load", ctypes.c_uint32),
        ("total", ctypes.c_uint64),
        ("available", ctypes.c_uint64),
        *((f"of no use {number}", ctypes.c_uint64) for number in range(5)),
    )


def memory_bytes() -> tuple[int | None, int | None]:
    """Return all memory there is and what is free of it; None for what the system does not tell."""
    status = _MemoryStatus(length=ctypes.sizeof(_MemoryStatus))
    if not ctypes.WinDLL("kernel32").GlobalMemoryStatusEx(ctypes.byref(status)):
        return None, None
    return int(status.total), int(status.available)


def takes_long_paths() -> bool:
    """Return whether paths may have more than 260 characters."""
    return bool(ctypes.WinDLL("ntdll").RtlAreLongPathsEnabled() & 0xFF)
