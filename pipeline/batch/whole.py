"""Small files of a queue that are whole or absent, without the locks that shared folders may not have."""

from __future__ import annotations

import os
from pathlib import Path

from scanloom.stages.files.moving import move
from scanloom.stages.files.replacing import draft_of


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that its name shows all of it or nothing.

    A process that is killed meanwhile may leave a draft, which the queue's end takes away.
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
