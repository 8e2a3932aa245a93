"""Atomic writes without locks, which network shares may not support."""

from __future__ import annotations

import os
from pathlib import Path

from scanloom.stages.files.moving import move
from scanloom.stages.files.replacing import draft_of


def write_whole(path: Path, data: bytes) -> None:
    """Write a file atomically: other processes see all of its content or no file.

    A process killed during the write may leave a draft, which is deleted with the queue.
    """
    draft = draft_of(path)
    try:
        with draft.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        move(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
