"""Diagnostics that several files have in common."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from scanloom.stages.diagnostics.diagnostic import Diagnostic


def merge_repeated(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Merge diagnostics that only differ in their file: the first one is kept, with the number of others."""
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
