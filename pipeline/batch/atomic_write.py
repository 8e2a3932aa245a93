"""Atomic writes without locks, which network shares may not support."""

from __future__ import annotations

import os
from pathlib import Path

from scanloom.stages.files.atomic_files import create_draft_path
from scanloom.stages.files.atomic_rename import rename_atomically


def write_atomically_unlocked(path: Path, data: bytes) -> None:
    """Write a file atomically: other processes see all of its content or no file.

    A process killed during the write may leave a draft, which is deleted with the queue.
    """
    draft = create_draft_path(path)
    try:
        with draft.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        rename_atomically(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
