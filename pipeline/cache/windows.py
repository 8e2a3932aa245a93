"""What Windows does in its way; `scanloom.pipeline.cache.posix` has the same functions.

Python's own `msvcrt.locking` knows no lock that several share and gives up after ten seconds; the system's
LockFileEx does what flock does elsewhere. The lock ends with the open file, so also when a process ends.
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

# For type checkers: what follows is not there elsewhere.
assert sys.platform == "win32"

import msvcrt  # noqa: E402
from ctypes import wintypes  # noqa: E402

_READ, _WRITE = 0x80000000, 0x40000000
# Of GENERIC_READ | GENERIC_WRITE; whoever opens the file may read, write, move and remove it meanwhile.
_SHARE_ALL = 0x7
_OPEN_EXISTING, _OPEN_ALWAYS = 3, 4
_NORMAL, _NOT_FOLLOWING = 0x80, 0x00200000
_AT_ONCE, _ALONE = 0x1, 0x2
# Where others hold it: ERROR_LOCK_VIOLATION, ERROR_IO_PENDING.
_HELD = (33, 997)
# Others can read and write all of the file: what is locked is a byte far beyond its end.
_FAR = 0x7FFFFFFF
# Seconds between looks at a lock that is waited for.
_FIRST_PAUSE, _LONGEST_PAUSE = 0.001, 0.05


class _Overlapped(ctypes.Structure):
    """OVERLAPPED: which byte of a file is meant."""

    _fields_ = (
        ("Internal", ctypes.c_void_p),
        ("InternalHigh", ctypes.c_void_p),
        ("Offset", wintypes.DWORD),
        ("OffsetHigh", wintypes.DWORD),
        ("hEvent", wintypes.HANDLE),
    )


class _MemoryCounters(ctypes.Structure):
    """PROCESS_MEMORY_COUNTERS."""

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
    """Open a lock file, made if need be when `writing`; no link is followed.

    Unlike files that Python opens, it can be moved and removed by others meanwhile.
    """
    handle = _kernel.CreateFileW(
        str(path),
        _READ | _WRITE if writing else _READ,
        _SHARE_ALL,
        None,
        _OPEN_ALWAYS if writing else _OPEN_EXISTING,
        _NORMAL | _NOT_FOLLOWING,
        None,
    )
    if handle is None or handle == wintypes.HANDLE(-1).value:
        raise _failure(path)
    descriptor = msvcrt.open_osfhandle(handle, os.O_RDWR if writing else os.O_RDONLY)
    if path.is_symlink():
        os.close(descriptor)
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    return descriptor


def open_folder_lock(folder: Path) -> int:
    """Open what is locked where a folder as a whole is meant: a file that stands for it."""
    name = os.path.normcase(os.path.realpath(folder))
    mark = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:32]
    return open_lock(Path(tempfile.gettempdir()) / f"scanloom-{mark}.lock", writing=True)


def lock(descriptor: int, *, shared: bool, wait: bool) -> None:
    """Lock an open file, with others that share it or alone; it ends when the file is closed.

    Raises
    ------
    BlockingIOError
        If it cannot be had at once and is not to be waited for.
    """
    pause = _FIRST_PAUSE
    # The system's own waiting would let no Ctrl-C through.
    while not _is_locked(descriptor, shared):
        if not wait:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        time.sleep(pause)
        pause = min(2 * pause, _LONGEST_PAUSE)


def _is_locked(descriptor: int, shared: bool) -> bool:
    handle = msvcrt.get_osfhandle(descriptor)
    place = _Overlapped(OffsetHigh=_FAR)
    if _kernel.LockFileEx(handle, _AT_ONCE | (0 if shared else _ALONE), 0, 1, 0, ctypes.byref(place)):
        return True
    if ctypes.get_last_error() in _HELD:
        return False
    raise _failure(None)


def _failure(path: Path | None) -> OSError:
    error = ctypes.WinError(ctypes.get_last_error())
    error.filename = None if path is None else str(path)
    return error


def flush(path: Path) -> None:
    """Wait until a file is on the disk; names in a folder are the file system's own care."""
    if path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR | os.O_BINARY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reset_peak() -> None:
    """Forget the peak so far, where the system can: it cannot."""


def peak_bytes() -> int:
    """Return the largest resident size since the process began; 0 if the system does not tell."""
    found = _MemoryCounters(cb=ctypes.sizeof(_MemoryCounters))
    told = _kernel.K32GetProcessMemoryInfo(_kernel.GetCurrentProcess(), ctypes.byref(found), found.cb)
    return int(found.PeakWorkingSetSize) if told else 0
