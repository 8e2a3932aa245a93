"""What Linux and macOS do in their way; `scanloom.pipeline.cache.windows` has the same functions."""

from __future__ import annotations

import fcntl
import os
import resource
import sys
from pathlib import Path

# For type checkers: what follows is not there elsewhere.
assert sys.platform != "win32"

_KILOBYTE = 1024


def open_lock(path: Path, *, writing: bool) -> int:
    """Open a lock file, made if need be when `writing`; no link is followed, no pipe waited for."""
    flags = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    return os.open(path, flags | (os.O_RDWR | os.O_CREAT if writing else os.O_RDONLY), 0o666)


def open_folder_lock(folder: Path) -> int:
    """Open what is locked where a folder as a whole is meant."""
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)


def lock(descriptor: int, *, shared: bool, wait: bool) -> None:
    """Lock an open file, with others that share it or alone; it ends when the file is closed.

    Raises
    ------
    BlockingIOError
        If it cannot be had at once and is not to be waited for.
    """
    fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))


def flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reset_peak() -> None:
    """Forget the peak so far, where the system can (Linux: proc(5), clear_refs)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def peak_bytes() -> int:
    """Return the largest resident size since `reset_peak`, or since the process began."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * _KILOBYTE
    except OSError:
        pass
    # macOS counts bytes, the others kilobytes.
    unit = 1 if sys.platform == "darwin" else _KILOBYTE
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
