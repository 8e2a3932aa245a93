"""Atomic writing of folders: write to a temporary folder, then rename it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.atomic_files import create_draft_path
from scanloom.stages.files.atomic_rename import rename_atomically
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED
from scanloom.stages.files.path_safety import resolve_path


@contextmanager
def write_folder_atomically(
    path: Path, may_replace: Callable[[Path], bool], description: str
) -> Iterator[Path]:
    """Provide a temporary folder that replaces `path` when the block succeeds.

    A reader finds the old folder, the new folder or no folder, never a mixture.

    Parameters
    ----------
    path : final folder; missing parents are created.
    may_replace : returns True if an existing non-empty folder may be replaced.
    description : name of such a folder in messages, such as "an asset folder".

    Raises
    ------
    InputError
        If there is a file or folder that may not be replaced.
    StageError
        If the system refuses to write.
    """
    target = resolve_path(path)
    require_replaceable_folder(path, may_replace, description)
    draft, old = create_draft_path(target), create_draft_path(target)
    try:
        try:
            draft.mkdir(parents=True)
            yield draft
            try:
                if target.exists():
                    rename_atomically(target, old)
                rename_atomically(draft, target)
            finally:
                if old.exists() and not target.exists():
                    rename_atomically(old, target)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
            shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise StageError(
            FILE_OUTPUT_REFUSED,
            "cannot be written: {detail}.",
            where=path,
            detail=error.strerror or error,
        ) from error


def require_replaceable_folder(path: Path, may_replace: Callable[[Path], bool], description: str) -> None:
    """Check that `write_folder_atomically` may replace a path; nothing is written.

    Raises
    ------
    InputError
        If `path` is a file, or a folder that is neither empty nor accepted by `may_replace`.
    """
    if not path.exists():
        return
    if not path.is_dir():
        raise InputError(FILE_OUTPUT_REFUSED, "this is a file; {what} is a folder.", path, what=description)
    if any(path.iterdir()) and not may_replace(path):
        raise InputError(
            FILE_OUTPUT_REFUSED,
            "this folder is not empty and is not {what}",
            path,
            remedy="give a new folder.",
            what=description,
        )
