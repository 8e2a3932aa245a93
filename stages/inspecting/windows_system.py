"""Windows system queries."""

from __future__ import annotations

import ctypes
import sys

# For type checkers: the rest of the module exists on Windows only.
assert sys.platform == "win32"


class _MemoryStatus(ctypes.Structure):
    """The Win32 structure MEMORYSTATUSEX."""

    _fields_ = (
        ("length", ctypes.c_uint32),
        ("load", ctypes.c_uint32),
        ("total", ctypes.c_uint64),
        ("available", ctypes.c_uint64),
        *((f"of no use {number}", ctypes.c_uint64) for number in range(5)),
    )


def query_memory_bytes() -> tuple[int | None, int | None]:
    """Return total and available memory in bytes; None if unknown."""
    status = _MemoryStatus(length=ctypes.sizeof(_MemoryStatus))
    if not ctypes.WinDLL("kernel32").GlobalMemoryStatusEx(ctypes.byref(status)):
        return None, None
    return int(status.total), int(status.available)


def supports_long_paths() -> bool:
    """Return True if paths may have more than 260 characters."""
    return bool(ctypes.WinDLL("ntdll").RtlAreLongPathsEnabled() & 0xFF)
