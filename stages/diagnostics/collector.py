"""Collector of diagnostics: code at any depth emits, and its caller collects."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace

from scanloom.stages.diagnostics.diagnostic import Diagnostic

_LISTENERS: ContextVar[tuple[Callable[[Diagnostic], object], ...]] = ContextVar("listeners", default=())


class DiagnosticWarning(UserWarning):
    """Python warning for a diagnostic that no caller collects."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(str(diagnostic))
        self.diagnostic = diagnostic


@contextmanager
def listening(listener: Callable[[Diagnostic], object], *, forward: bool = True) -> Iterator[None]:
    """Call a function with each diagnostic that is emitted in the block.

    The block covers this thread and threads that read ahead for it. Do not yield from a generator inside it.

    Parameters
    ----------
    forward : outer blocks receive the diagnostics, too. False for attempts whose results may be dropped.
    """
    token = _LISTENERS.set((*_LISTENERS.get(), listener) if forward else (listener,))
    try:
        yield
    finally:
        _LISTENERS.reset(token)


@contextmanager
def collecting(*, forward: bool = True) -> Iterator[list[Diagnostic]]:
    """Collect the diagnostics that are emitted in the block, each once; see `listening`."""
    collected: list[Diagnostic] = []

    def add(diagnostic: Diagnostic) -> None:
        if diagnostic not in collected:
            collected.append(diagnostic)

    with listening(add, forward=forward):
        yield collected


@contextmanager
def changing(change: Callable[[Diagnostic], Diagnostic]) -> Iterator[None]:
    """Change the diagnostics of the block, such as their location, before outer blocks receive them."""
    outer = _LISTENERS.get()

    def forward(diagnostic: Diagnostic) -> None:
        changed = change(diagnostic)
        for listener in outer:
            listener(changed)

    with listening(forward, forward=False):
        yield


def emit(*diagnostics: Diagnostic) -> None:
    """Hand diagnostics to all blocks around the caller; without any, they become Python warnings."""
    listeners = _LISTENERS.get()
    for diagnostic in diagnostics:
        if not listeners:
            warnings.warn(DiagnosticWarning(diagnostic), stacklevel=3)
        for listener in listeners:
            listener(diagnostic)


def merge_repeated(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Merge diagnostics that only differ in their file: keep the first and add the number of others."""
    groups: dict[Diagnostic, list[Diagnostic]] = {}
    for one in diagnostics:
        groups.setdefault(replace(one, where=None), []).append(one)
    merged = []
    for first, *others in groups.values():
        if not others:
            merged.append(first)
            continue
        message = f"{first.message} (and {len(others):,} more files)"
        merged.append(replace(first, message=message, values={**first.values, "more_files": len(others)}))
    return merged
