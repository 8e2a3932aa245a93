"""Collection of diagnostics: code at any depth emits them, and callers collect them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace

from scanloom.stages.diagnostics.diagnostic import Diagnostic

_DIAGNOSTIC_LISTENERS: ContextVar[tuple[Callable[[Diagnostic], object], ...]] = ContextVar(
    "listeners", default=()
)


class DiagnosticWarning(UserWarning):
    """Python warning for a diagnostic that no caller collects."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(str(diagnostic))
        self.diagnostic = diagnostic


@contextmanager
def listen_to_diagnostics(
    listener: Callable[[Diagnostic], object], *, forward: bool = True
) -> Iterator[None]:
    """Call a function with each diagnostic emitted inside the block.

    The block covers this thread and threads started by `map_ordered`. A generator must not yield inside the
    block.

    Parameters
    ----------
    forward : pass the diagnostics to enclosing blocks, too. False for attempts whose results may be
        discarded.
    """
    token = _DIAGNOSTIC_LISTENERS.set((*_DIAGNOSTIC_LISTENERS.get(), listener) if forward else (listener,))
    try:
        yield
    finally:
        _DIAGNOSTIC_LISTENERS.reset(token)


@contextmanager
def collecting(*, forward: bool = True) -> Iterator[list[Diagnostic]]:
    """Collect the diagnostics emitted inside the block, without duplicates.

    `forward` as in `listen_to_diagnostics`.
    """
    collected: list[Diagnostic] = []

    def add(diagnostic: Diagnostic) -> None:
        if diagnostic not in collected:
            collected.append(diagnostic)

    with listen_to_diagnostics(add, forward=forward):
        yield collected


@contextmanager
def transform_diagnostics(change: Callable[[Diagnostic], Diagnostic]) -> Iterator[None]:
    """Transform diagnostics of the block before enclosing blocks receive them.

    `change` may for example set their location.
    """
    outer = _DIAGNOSTIC_LISTENERS.get()

    def forward(diagnostic: Diagnostic) -> None:
        changed = change(diagnostic)
        for listener in outer:
            listener(changed)

    with listen_to_diagnostics(forward, forward=False):
        yield


def emit(*diagnostics: Diagnostic) -> None:
    """Pass diagnostics to all enclosing blocks.

    Without an enclosing block they become Python warnings.
    """
    listeners = _DIAGNOSTIC_LISTENERS.get()
    for diagnostic in diagnostics:
        if not listeners:
            warnings.warn(DiagnosticWarning(diagnostic), stacklevel=3)
        for listener in listeners:
            listener(diagnostic)


def merge_repeated(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Merge diagnostics that differ only in their location.

    The first one is kept; the number of the others is added to its message.
    """
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
