"""Collector of diagnostics: code at any depth emits, and its caller collects."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from stages.diagnostics.diagnostic import Diagnostic


class DiagnosticWarning(UserWarning):
    """Warning for a diagnostic that no caller collects."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(str(diagnostic))
        self.diagnostic = diagnostic


_COLLECTORS: ContextVar[tuple[list[Diagnostic], ...]] = ContextVar("collectors", default=())


@contextmanager
def collecting(*, forward: bool = True) -> Iterator[list[Diagnostic]]:
    """Collect what is emitted in the block, each once, by this thread and those it reads ahead with.

    Parameters
    ----------
    forward : outer blocks receive the diagnostics, too. False for attempts whose results may be dropped.
    """
    collected: list[Diagnostic] = []
    outer = _COLLECTORS.get() if forward else ()
    token = _COLLECTORS.set((*outer, collected))
    try:
        yield collected
    finally:
        _COLLECTORS.reset(token)


def emit(*diagnostics: Diagnostic) -> None:
    """Hand diagnostics to all collectors around the caller; without any, they become Python warnings."""
    collectors = _COLLECTORS.get()
    for diagnostic in diagnostics:
        if not collectors:
            warnings.warn(DiagnosticWarning(diagnostic), stacklevel=3)
        for collected in collectors:
            if diagnostic not in collected:
                collected.append(diagnostic)


def emit_all(diagnostics: Iterable[Diagnostic]) -> None:
    """Emit several diagnostics in order."""
    emit(*diagnostics)
