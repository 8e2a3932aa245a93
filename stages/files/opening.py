"""Open files that are read: regular ones only.

A pipe, a device or a socket under the name of a file would keep a reader waiting, or never end. What reads an
input opens it here; `tests/stages/files/test_opening.py` walks the sources for what does not.
"""

from __future__ import annotations

import errno
import io
import os
import stat
from pathlib import Path
from typing import BinaryIO

from scanloom.stages.files.noting import note

# Bytes as they are, where a system would make others of them; and without waiting, where it can wait.
_READING = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))
_KINDS = (
    (stat.S_ISFIFO, "it is a pipe, not a file"),
    (stat.S_ISSOCK, "it is a socket, not a file"),
    (stat.S_ISCHR, "it is a device, not a file"),
    (stat.S_ISBLK, "it is a device, not a file"),
)


def opened(path: Path) -> BinaryIO:
    """Open a regular file, to read its bytes.

    Raises
    ------
    OSError
        If there is none, it may not be read, or it is a folder, a pipe, a device or a socket.
    """
    # Looked at before it is opened: opening is enough to make some devices do something.
    require_regular(path)
    # What became a pipe since then does not keep this waiting.
    descriptor = os.open(path, _READING)
    try:
        _require_regular(os.fstat(descriptor).st_mode, path)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def content_of(path: Path) -> bytes:
    """Return what is in a regular file; see `opened`."""
    with opened(path) as file:
        return file.read()


def text_in(path: Path, encoding: str) -> str:
    """Return the text of a regular file, its lines ended by line feeds alone; see `opened`."""
    with io.TextIOWrapper(opened(path), encoding) as file:
        return file.read()


def require_regular(path: Path) -> Path:
    """Return the path of a regular file for a library that opens it by itself; see `opened`."""
    _require_regular(path.stat().st_mode, path)
    note(path)
    return path


def said_of(error: OSError | ValueError) -> str:
    """Return what the system says of a file that cannot be opened, without its name and a number."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _require_regular(mode: int, path: Path) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        said = next((text for is_kind, text in _KINDS if is_kind(mode)), "it is no file")
        raise OSError(errno.EINVAL, said, str(path))
