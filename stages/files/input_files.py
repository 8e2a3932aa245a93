"""Opening of input files, restricted to regular files.

A pipe, device or socket in place of a file could block a reader or never end. All inputs are opened by this
module; `tests/stages/files/test_input_files.py` searches the sources for exceptions.
"""

from __future__ import annotations

import errno
import io
import os
import stat
from pathlib import Path
from typing import BinaryIO

from scanloom.stages.files.file_access_log import record_opened

# O_BINARY disables newline translation on Windows; O_NONBLOCK prevents blocking on a pipe.
_OPEN_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))
_SPECIAL_FILES = (
    (stat.S_ISFIFO, "it is a pipe, not a file"),
    (stat.S_ISSOCK, "it is a socket, not a file"),
    (stat.S_ISCHR, "it is a device, not a file"),
    (stat.S_ISBLK, "it is a device, not a file"),
)


def open_input(path: Path) -> BinaryIO:
    """Open a regular file for reading bytes.

    Raises
    ------
    OSError
        If the file does not exist, is not readable, or is a folder, pipe, device or socket.
    """
    # Checked before opening, because opening alone triggers side effects on some devices.
    require_regular_file(path)
    # O_NONBLOCK: the path may have become a pipe since the check.
    descriptor = os.open(path, _OPEN_FLAGS)
    try:
        _require_regular_mode(os.fstat(descriptor).st_mode, path)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_input_bytes(path: Path) -> bytes:
    """Read the bytes of a regular file; see `open_input`."""
    with open_input(path) as file:
        return file.read()


def read_input_text(path: Path, encoding: str) -> str:
    r"""Read the text of a regular file with `\n` line ends.

    See `open_input`.
    """
    with io.TextIOWrapper(open_input(path), encoding) as file:
        return file.read()


def require_regular_file(path: Path) -> Path:
    """Check that a path is a regular file and record it as opened.

    For libraries that open files themselves; see `open_input` for the errors.
    """
    _require_regular_mode(path.stat().st_mode, path)
    record_opened(path)
    return path


def describe_os_error(error: OSError | ValueError) -> str:
    """Describe why a file cannot be opened, without its name and errno."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _require_regular_mode(mode: int, path: Path) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        said = next((text for is_kind, text in _SPECIAL_FILES if is_kind(mode)), "it is no file")
        raise OSError(errno.EINVAL, said, str(path))
