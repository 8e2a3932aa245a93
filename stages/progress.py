"""Progress callback protocol."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Progress callback, called from the worker thread at irregular intervals.

    An exception raised in the callback aborts the work.
    """

    def __call__(self, done: int, total: int) -> object:
        """Report that `done` of `total` units (frames, collapses) are finished.

        Returning False requests a partial result. Functions that have no useful partial result ignore the
        value.
        """


def ignore_progress(done: int, total: int) -> None:
    """Ignore progress; the default callback."""
