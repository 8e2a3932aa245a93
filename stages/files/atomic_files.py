"""Atomic writing of files: write to a temporary file, then rename it."""

from __future__ import annotations

import hashlib
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.atomic_rename import rename_atomically
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED, FILE_PATH_INVALID
from scanloom.stages.files.path_safety import resolve_path

# Bytes. File systems limit names to 255; the name of a temporary file is longer by `_DRAFT_SUFFIX_LENGTH`.
_MAX_NAME_BYTES = 255
_DRAFT_SUFFIX_LENGTH = len(f"..{secrets.token_hex(4)}.part")


@contextmanager
def write_file_atomically(path: Path) -> Iterator[Path]:
    """Provide a temporary path that replaces `path` when the block succeeds.

    The temporary file is in the folder of `path`. A reader finds the old file, the new file or no file, never
    a partial one. If `path` is a symbolic link, its target is replaced. Permissions are kept.

    Raises
    ------
    InputError
        If `path` is a folder, is not a regular file, or is not writable.
    StageError
        If the system refuses to write: missing folder, permissions, disk full.
    """
    target = resolve_path(path) if path.is_symlink() else path
    draft = create_draft_path(target)
    try:
        mode = _check_replaceable(target, path)
        try:
            yield draft
            with draft.open("rb+") as file:
                os.fsync(file.fileno())
            if mode is not None:
                draft.chmod(mode)
            rename_atomically(draft, target)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise StageError(
            FILE_OUTPUT_REFUSED,
            "cannot be written: {detail}.",
            where=path,
            detail=error.strerror or error,
        ) from error


def _check_replaceable(target: Path, named: Path) -> int | None:
    """Check that a file may be replaced and return its permission bits.

    Returns None if the file does not exist. `named` is the path for messages.

    Raises
    ------
    InputError
        If the target is a folder, is not a regular file, or is not writable.
    """
    try:
        found = target.stat()
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(FILE_PATH_INVALID, "this is a folder", named, remedy="give the name of a file.")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(
            FILE_OUTPUT_REFUSED,
            "this is not a regular file, so it is not replaced",
            named,
            remedy="give another path.",
        )
    if not os.access(target, os.W_OK):
        raise InputError(
            FILE_OUTPUT_REFUSED,
            "this file is not writable",
            named,
            remedy="change its permissions or give another path.",
        )
    return stat.S_IMODE(found.st_mode)


def create_draft_path(path: Path) -> Path:
    """Return a unique temporary path in the folder of `path`."""
    return path.with_name(f".{get_draft_stem(path.name)}.{secrets.token_hex(4)}.part")


def get_draft_stem(name: str) -> str:
    """Return the name stem of temporary files of a file.

    This is the name itself, or its SHA-256 if the temporary name would exceed 255 bytes.
    """
    if len(os.fsencode(name)) + _DRAFT_SUFFIX_LENGTH <= _MAX_NAME_BYTES:
        return name
    return hashlib.sha256(os.fsencode(name)).hexdigest()
