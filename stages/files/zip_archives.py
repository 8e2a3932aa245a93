"""Readers for ZIP archives from untrusted sources."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_ARCHIVE_DAMAGED, FILE_DAMAGED
from scanloom.stages.files.input_files import require_regular_file

# Exceptions of reading an archive; RuntimeError is raised for encrypted entries.
ARCHIVE_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    OSError,
    EOFError,
    ValueError,
    RuntimeError,
    KeyError,
    OverflowError,
    struct.error,
)
# zipfile limits the output of these methods only; other methods can expand kilobytes to gigabytes at once.
_BOUNDED_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def open_archive(path: Path) -> zipfile.ZipFile:
    """Open a ZIP archive and read its list of entries.

    Raises
    ------
    InputError
        If the archive cannot be opened, or is damaged.
    """
    try:
        return zipfile.ZipFile(require_regular_file(path))
    except ARCHIVE_ERRORS as error:
        raise InputError(
            FILE_DAMAGED,
            "the archive does not open; it is damaged or was cut short.",
            path,
            remedy="Copy it again.",
        ) from error


def read_entry(archive: zipfile.ZipFile, name: str, path: Path, max_bytes: int) -> bytes:
    """Read the content of an archive entry.

    Parameters
    ----------
    path : path of the archive, for messages.
    max_bytes : maximum size of the unpacked entry, bytes.

    Raises
    ------
    InputError
        If the entry is missing, damaged or larger than `max_bytes`, or uses another compression than deflate.
    """
    try:
        entry = archive.getinfo(name)
        if entry.file_size > max_bytes:
            raise InputError(
                FILE_ARCHIVE_DAMAGED,
                "{name} is too large: it has {size:,} bytes, and at most {limit:,} are expected.",
                path,
                name=name,
                size=entry.file_size,
                limit=max_bytes,
            )
        if not has_bounded_size(entry):
            raise InputError(
                FILE_ARCHIVE_DAMAGED,
                "{name} has an unsupported compression method; pack the archive again with deflate.",
                path,
                name=name,
            )
        with archive.open(entry) as content:
            # read() without a size would unpack everything before the size is compared with the header.
            return content.read(max(entry.file_size, 1))
    except ARCHIVE_ERRORS as error:
        raise InputError(
            FILE_DAMAGED, "{name} cannot be read from the archive; it is damaged.", path, name=name
        ) from error


def has_bounded_size(entry: zipfile.ZipInfo) -> bool:
    """Return True if zipfile limits the unpacked size of an entry (stored or deflated)."""
    return entry.compress_type in _BOUNDED_METHODS
