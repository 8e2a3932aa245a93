"""Log of the files that are opened while a scan is read.

Files of the scan folder that are absent from the log were not used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_OPENED_FILES: ContextVar[set[Path] | None] = ContextVar("noted", default=None)


@contextmanager
def record_opened_files() -> Iterator[set[Path]]:
    """Record the paths that this thread opens inside the block."""
    noted: set[Path] = set()
    before = _OPENED_FILES.set(noted)
    try:
        yield noted
    finally:
        _OPENED_FILES.reset(before)


@contextmanager
def pause_recording() -> Iterator[None]:
    """Pause recording inside the block, for files opened only to detect their format."""
    before = _OPENED_FILES.set(None)
    try:
        yield
    finally:
        _OPENED_FILES.reset(before)


def record_opened(path: Path) -> None:
    """Record a path as opened."""
    noted = _OPENED_FILES.get()
    if noted is not None:
        noted.add(path)
