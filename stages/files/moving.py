"""Move a file or a folder to another name in one step, on every system."""

from __future__ import annotations

import sys
import time
from pathlib import Path

# Seconds for which a move is tried again on Windows, and between two tries.
_PATIENCE, _PAUSE = 2.0, 0.05


def move(source: Path, target: Path) -> None:
    """Give a file or a folder another name; a file takes the place of a file, a folder of an empty folder.

    Windows moves nothing that a program has open, nor a folder in which one has a file open. Scanners and
    indexers open what is new for moments, so it is tried again for two seconds there.

    Raises
    ------
    OSError
        If the system refuses.
    """
    if sys.platform == "win32":
        _move_with_patience(source, target)
    else:
        source.replace(target)


def _move_with_patience(source: Path, target: Path) -> None:
    end = time.monotonic() + _PATIENCE
    while True:
        try:
            if source.is_dir() and target.is_dir():
                target.rmdir()
            source.replace(target)
            return
        except PermissionError:
            if time.monotonic() > end:
                raise
        time.sleep(_PAUSE)
