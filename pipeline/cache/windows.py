"""System functions for Windows; same interface as `scanloom.pipeline.cache.posix`.

LockFileEx is called directly, because `msvcrt.locking` has no shared locks and gives up after ten seconds.
The lock ends when the file is closed, and so also when the process ends.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import os
import sys
import tempfile
import time
from pathlib import Path

# For type checkers: the modules below only exist on Windows.
assert sys.platform == "win32"

import msvcrt  # noqa: E402
from ctypes import wintypes  # noqa: E402

_READ, _WRITE = 0x80000000, 0x40000000
# FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE: other processes may move and remove the open file.
_SHARE_ALL = 0x7
_OPEN_EXISTING, _OPEN_ALWAYS = 3, 4
_NORMAL, _OPEN_REPARSE_POINT = 0x80, 0x00200000
_FAIL_IMMEDIATELY, _EXCLUSIVE = 0x1, 0x2
# Errors if another process holds the lock: ERROR_LOCK_VIOLATION, ERROR_IO_PENDING.
_HELD_ERRORS = (33, 997)
# High word of the locked byte's offset: far beyond the end, so that the content stays accessible.
_LOCK_OFFSET_HIGH = 0x7FFFFFFF
# Seconds between two attempts to lock; doubled up to the maximum.
_FIRST_PAUSE, _MAX_PAUSE = 0.001, 0.05


class _Overlapped(ctypes.Structure):
    """OVERLAPPED structure: offset of the locked byte."""

    _fields_ = (
        ("Internal", ctypes.c_void_p),
        ("InternalHigh", ctypes.c_void_p),
        ("Offset", wintypes.DWORD),
        ("OffsetHigh", wintypes.DWORD),
        ("hEvent", wintypes.HANDLE),
    )


class _MemoryCounters(ctypes.Structure):
    """PROCESS_MEMORY_COUNTERS structure."""

    _fields_ = (
        ("cb", wintypes.DWORD),
        ("PageFaultCount", wintypes.DWORD),
        ("PeakWorkingSetSize", ctypes.c_size_t),
        *((f"of no use {number}", ctypes.c_size_t) for number in range(7)),
    )


_kernel = ctypes.WinDLL("kernel32", use_last_error=True)
_kernel.CreateFileW.argtypes = (
    *(wintypes.LPCWSTR, wintypes.DWORD, wintypes.DWORD, ctypes.c_void_p),
    *(wintypes.DWORD, wintypes.DWORD, wintypes.HANDLE),
)
_kernel.CreateFileW.restype = wintypes.HANDLE
_kernel.LockFileEx.argtypes = (wintypes.HANDLE, *(wintypes.DWORD,) * 4, ctypes.POINTER(_Overlapped))
_kernel.GetCurrentProcess.restype = wintypes.HANDLE
_kernel.K32GetProcessMemoryInfo.argtypes = (wintypes.HANDLE, ctypes.POINTER(_MemoryCounters), wintypes.DWORD)


def open_lock(path: Path, *, writing: bool) -> int:
    """Open a lock file, creating it if `writing`; do not follow links.

    Unlike files opened by Python, the file can be moved and removed by others while it is open.
    """
    handle = _kernel.CreateFileW(
        str(path),
        _READ | _WRITE if writing else _READ,
        _SHARE_ALL,
        None,
        _OPEN_ALWAYS if writing else _OPEN_EXISTING,
        _NORMAL | _OPEN_REPARSE_POINT,
        None,
    )
    if handle is None or handle == wintypes.HANDLE(-1).value:
        raise _make_error(path)
    descriptor = msvcrt.open_osfhandle(handle, os.O_RDWR if writing else os.O_RDONLY)
    if path.is_symlink():
        os.close(descriptor)
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    return descriptor


def open_folder_lock(folder: Path) -> int:
    """Open a lock file in the temporary folder that represents a folder."""
    name = os.path.normcase(os.path.realpath(folder))
    mark = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:32]
    return open_lock(Path(tempfile.gettempdir()) / f"scanloom-{mark}.lock", writing=True)


def lock(descriptor: int, *, shared: bool, wait: bool) -> None:
    """Lock an open file, shared or exclusively, until it is closed.

    Raises
    ------
    BlockingIOError
        If another process holds the lock and `wait` is False.
    """
    pause = _FIRST_PAUSE
    # Poll: a blocking LockFileEx could not be interrupted by Ctrl-C.
    while not _is_locked(descriptor, shared):
        if not wait:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        time.sleep(pause)
        pause = min(2 * pause, _MAX_PAUSE)


def _is_locked(descriptor: int, shared: bool) -> bool:
    handle = msvcrt.get_osfhandle(descriptor)
    place = _Overlapped(OffsetHigh=_LOCK_OFFSET_HIGH)
    if _kernel.LockFileEx(
        handle, _FAIL_IMMEDIATELY | (0 if shared else _EXCLUSIVE), 0, 1, 0, ctypes.byref(place)
    ):
        return True
    if ctypes.get_last_error() in _HELD_ERRORS:
        return False
    raise _make_error(None)


def _make_error(path: Path | None) -> OSError:
    error = ctypes.WinError(ctypes.get_last_error())
    error.filename = None if path is None else str(path)
    return error


def flush(path: Path) -> None:
    """Flush a file to disk; Windows cannot flush folders."""
    if path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR | os.O_BINARY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reset_peak_bytes() -> None:
    """Do nothing: Windows cannot reset the peak memory."""


def get_peak_bytes() -> int:
    """Return the peak resident memory in bytes since process start; 0 if unknown."""
    found = _MemoryCounters(cb=ctypes.sizeof(_MemoryCounters))
    told = _kernel.K32GetProcessMemoryInfo(_kernel.GetCurrentProcess(), ctypes.byref(found), found.cb)
    return int(found.PeakWorkingSetSize) if told else 0
