"""Write a folder beside its place and move it there whole."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED
from scanloom.stages.files.moving import move
from scanloom.stages.files.replacing import draft_of


@contextmanager
def replacing_folder(path: Path, is_ours: Callable[[Path], bool], what: str) -> Iterator[Path]:
    """Give a new folder beside `path`; it takes the name of `path` when the block ends well.

    A reader finds the old folder, the new one or none, never parts of both.

    Parameters
    ----------
    path : in a folder that is made if need be.
    is_ours : says of the folder there is already, if it is not empty, whether it may be replaced.
    what : what such a folder is called.

    Raises
    ------
    InputError
        If there is something that may not be replaced.
    StageError
        If the system refuses to write.
    """
    target = path.resolve()
    require_replaceable_folder(path, is_ours, what)
    draft, old = draft_of(target), draft_of(target)
    try:
        try:
            draft.mkdir(parents=True)
            yield draft
            try:
                if target.exists():
                    move(target, old)
                move(draft, target)
            finally:
                if old.exists() and not target.exists():
                    move(old, target)
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


def require_replaceable_folder(path: Path, is_ours: Callable[[Path], bool], what: str) -> None:
    """Check that `replacing_folder` may be used for a path; nothing is made yet.

    Raises
    ------
    InputError
        If there is a file, or a folder that is neither empty nor ours.
    """
    if not path.exists():
        return
    if not path.is_dir():
        raise InputError(FILE_OUTPUT_REFUSED, "this is a file; {what} is a folder.", path, what=what)
    if any(path.iterdir()) and not is_ours(path):
        raise InputError(
            FILE_OUTPUT_REFUSED,
            "this folder is not empty and is not {what}",
            path,
            remedy="name a new one.",
            what=what,
        )
