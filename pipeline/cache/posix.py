"""System functions for Linux and macOS; same interface as `scanloom.pipeline.cache.windows`."""

from __future__ import annotations

import fcntl
import os
import resource
import sys
from pathlib import Path

# For type checkers: the modules below only exist on POSIX systems.
assert sys.platform != "win32"

_KILOBYTE = 1024


def open_lock(path: Path, *, writing: bool) -> int:
    """Open a lock file, creating it if `writing`.

    Links are not followed, and pipes do not block.
    """
    flags = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    return os.open(path, flags | (os.O_RDWR | os.O_CREAT if writing else os.O_RDONLY), 0o666)


def open_folder_lock(folder: Path) -> int:
    """Open a folder, to lock it."""
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)


def lock(descriptor: int, *, shared: bool, wait: bool) -> None:
    """Lock an open file, shared or exclusively, until it is closed.

    Raises
    ------
    BlockingIOError
        If another process holds the lock and `wait` is False.
    """
    fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))


def flush(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reset_peak_bytes() -> None:
    """Reset the peak memory of the process, if supported (Linux: proc(5), clear_refs)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def get_peak_bytes() -> int:
    """Return the peak resident memory in bytes since `reset_peak_bytes`, or since process start."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * _KILOBYTE
    except OSError:
        pass
    # ru_maxrss is in bytes on macOS, in kilobytes elsewhere.
    unit = 1 if sys.platform == "darwin" else _KILOBYTE
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
