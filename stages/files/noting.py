"""Log of the files that are opened while a scan is read.

Files of the scan folder that are absent from the log were not used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_NOTED: ContextVar[set[Path] | None] = ContextVar("noted", default=None)


@contextmanager
def noting() -> Iterator[set[Path]]:
    """Record the paths that this thread opens inside the block."""
    noted: set[Path] = set()
    before = _NOTED.set(noted)
    try:
        yield noted
    finally:
        _NOTED.reset(before)


@contextmanager
def only_looking() -> Iterator[None]:
    """Pause recording inside the block, for files opened only to detect their format."""
    before = _NOTED.set(None)
    try:
        yield
    finally:
        _NOTED.reset(before)


def note(path: Path) -> None:
    """Record a path as opened."""
    noted = _NOTED.get()
    if noted is not None:
        noted.add(path)
