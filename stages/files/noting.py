"""Which files were opened while something was read: what a folder holds beside them, nobody used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_NOTED: ContextVar[set[Path] | None] = ContextVar("noted", default=None)


@contextmanager
def noting() -> Iterator[set[Path]]:
    """Collect the paths that are opened in the block, by the thread that runs it."""
    noted: set[Path] = set()
    before = _NOTED.set(noted)
    try:
        yield noted
    finally:
        _NOTED.reset(before)


@contextmanager
def only_looking() -> Iterator[None]:
    """Note nothing in the block: files are opened to find out what they are."""
    before = _NOTED.set(None)
    try:
        yield
    finally:
        _NOTED.reset(before)


def note(path: Path) -> None:
    """Remember that a file is used."""
    noted = _NOTED.get()
    if noted is not None:
        noted.add(path)
