"""How long work tells how far it is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called now and then from the working thread; raising from it stops the work."""

    def __call__(self, done: int, total: int) -> object:
        """Say that `done` of `total` units (frames, collapses) are finished.

        Where part of a result is of use, returning False asks for what there is; elsewhere it means nothing.
        """


def silent(done: int, total: int) -> None:
    """Progress that nobody watches."""
