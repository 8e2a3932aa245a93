"""Read entries of ZIP archives without trusting what they promise."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_ARCHIVE_DAMAGED, FILE_DAMAGED
from scanloom.stages.files.opening import require_regular

# What reading an archive can raise; RuntimeError is for an encryption nobody asked for.
FAULTS = (
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
# The other methods of compression unpack as much as they like at once: gigabytes from a few kilobytes.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def opened_archive(path: Path) -> zipfile.ZipFile:
    """Open an archive, its list of entries read.

    Raises
    ------
    InputError
        If it cannot be opened, or is damaged.
    """
    try:
        return zipfile.ZipFile(require_regular(path))
    except FAULTS as error:
        raise InputError(
            FILE_DAMAGED,
            "the archive does not open; it is damaged or was cut short.",
            path,
            remedy="Copy it again.",
        ) from error


def entry_content(archive: zipfile.ZipFile, name: str, path: Path, most: int) -> bytes:
    """Return what an entry holds.

    Parameters
    ----------
    path : of the archive, for messages.
    most : bytes that it may hold.

    Raises
    ------
    InputError
        If there is no such entry, it is damaged, would unpack to more, or is compressed in another way than
        by deflate.
    """
    try:
        entry = archive.getinfo(name)
        if entry.file_size > most:
            raise InputError(
                FILE_ARCHIVE_DAMAGED, "{name} is too large for what it should hold.", path, name=name
            )
        if not is_bounded(entry):
            raise InputError(
                FILE_ARCHIVE_DAMAGED,
                "{name} is compressed in a way that is not read; pack the archive again with deflate.",
                path,
                name=name,
            )
        with archive.open(entry) as content:
            # A read of all there is would unpack it before its size is compared with what the entry says.
            return content.read(max(entry.file_size, 1))
    except FAULTS as error:
        raise InputError(
            FILE_DAMAGED, "{name} cannot be read from the archive; it is damaged.", path, name=name
        ) from error


def is_bounded(entry: zipfile.ZipInfo) -> bool:
    """Return whether an entry unpacks to no more than it says: it is stored as it is, or deflated."""
    return entry.compress_type in _METHODS
