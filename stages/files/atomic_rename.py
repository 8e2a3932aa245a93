"""Atomic rename of files and folders on every system."""

from __future__ import annotations

import sys
import time
from pathlib import Path

# Seconds: total time of retries on Windows, and delay between two retries.
_RETRY_DURATION_S, _RETRY_DELAY_S = 2.0, 0.05


def rename_atomically(source: Path, target: Path) -> None:
    """Rename a file or folder, replacing a file or an empty folder.

    Windows cannot rename a file that any program has open, nor a folder that contains one. Virus scanners and
    indexers open new files briefly, so the rename is retried for two seconds there.

    Raises
    ------
    OSError
        If the system refuses.
    """
    if sys.platform == "win32":
        _rename_with_retries(source, target)
    else:
        source.replace(target)


def _rename_with_retries(source: Path, target: Path) -> None:
    end = time.monotonic() + _RETRY_DURATION_S
    while True:
        try:
            if source.is_dir() and target.is_dir():
                target.rmdir()
            source.replace(target)
            return
        except PermissionError:
            if time.monotonic() > end:
                raise
        time.sleep(_RETRY_DELAY_S)
