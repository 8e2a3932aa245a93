"""Write a file beside its place and move it there whole; what is there is replaced as `cp` does."""

from __future__ import annotations

import hashlib
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED, FILE_PATH_INVALID
from scanloom.stages.files.moving import move

# Bytes of a name that file systems take; a draft's is longer than its file's by the rest.
_LONGEST_NAME = 255
_ADDED = len(f"..{secrets.token_hex(4)}.part")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path in the folder of `path`; it takes the name of `path` when the block ends well.

    Whatever happens, a reader finds the old file, the new one or none, never a part. Of a symbolic link the
    file it leads to is replaced; permissions stay.

    Raises
    ------
    InputError
        If there is something that is no file, as a folder, or a file that may not be written.
    StageError
        If the system refuses to write: no such folder, no permission, no space.
    """
    target = path.resolve() if path.is_symlink() else path
    part = draft_of(target)
    try:
        mode = _mode_of_replaceable(target, path)
        try:
            yield part
            with part.open("rb+") as file:
                os.fsync(file.fileno())
            if mode is not None:
                part.chmod(mode)
            move(part, target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise StageError(
            FILE_OUTPUT_REFUSED,
            "cannot be written: {detail}.",
            where=path,
            detail=error.strerror or error,
        ) from error


def _mode_of_replaceable(target: Path, named: Path) -> int | None:
    """Return the permissions of a file that is to be replaced, None if there is none; refuse all else."""
    try:
        found = target.stat()
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(FILE_PATH_INVALID, "this is a folder", named, remedy="give the name of a file.")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(
            FILE_OUTPUT_REFUSED, "this is no plain file and is not replaced", named, remedy="name another."
        )
    if not os.access(target, os.W_OK):
        raise InputError(
            FILE_OUTPUT_REFUSED,
            "this file may not be written",
            named,
            remedy="change its permissions or name another.",
        )
    return stat.S_IMODE(found.st_mode)


def draft_of(path: Path) -> Path:
    """Return a path beside `path` for its next content; no two calls give the same one."""
    return path.with_name(f".{stem_of_drafts(path.name)}.{secrets.token_hex(4)}.part")


def stem_of_drafts(name: str) -> str:
    """Return what stands for a file's name in those of its drafts: itself, unless they would be too long."""
    if len(os.fsencode(name)) + _ADDED <= _LONGEST_NAME:
        return name
    return hashlib.sha256(os.fsencode(name)).hexdigest()
