"""Opening of input files, restricted to regular files.

A pipe, device or socket in place of a file could block a reader or never end. All inputs are opened by this
module; `tests/stages/files/test_opening.py` searches the sources for exceptions.
"""

from __future__ import annotations

import errno
import io
import os
import stat
from pathlib import Path
from typing import BinaryIO

from scanloom.stages.files.noting import note

# O_BINARY disables newline translation on Windows; O_NONBLOCK prevents blocking on a pipe.
_READING = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))
_KINDS = (
    (stat.S_ISFIFO, "it is a pipe, not a file"),
    (stat.S_ISSOCK, "it is a socket, not a file"),
    (stat.S_ISCHR, "it is a device, not a file"),
    (stat.S_ISBLK, "it is a device, not a file"),
)


def opened(path: Path) -> BinaryIO:
    """Open a regular file for reading bytes.

    Raises
    ------
    OSError
        If the file does not exist, is not readable, or is a folder, pipe, device or socket.
    """
    # Checked before opening, because opening alone triggers side effects on some devices.
    require_regular(path)
    # O_NONBLOCK: the path may have become a pipe since the check.
    descriptor = os.open(path, _READING)
    try:
        _require_regular(os.fstat(descriptor).st_mode, path)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def content_of(path: Path) -> bytes:
    """Read the bytes of a regular file; see `opened`."""
    with opened(path) as file:
        return file.read()


def text_in(path: Path, encoding: str) -> str:
    r"""Read the text of a regular file with `\n` line ends.

    See `opened`.
    """
    with io.TextIOWrapper(opened(path), encoding) as file:
        return file.read()


def require_regular(path: Path) -> Path:
    """Check that a path is a regular file and record it as opened.

    For libraries that open files themselves; see `opened` for the errors.
    """
    _require_regular(path.stat().st_mode, path)
    note(path)
    return path


def said_of(error: OSError | ValueError) -> str:
    """Describe why a file cannot be opened, without its name and errno."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _require_regular(mode: int, path: Path) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        said = next((text for is_kind, text in _KINDS if is_kind(mode)), "it is no file")
        raise OSError(errno.EINVAL, said, str(path))
