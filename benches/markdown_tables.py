"""Markdown tables printed row by row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def print_head(columns: Sequence[str], words: int = 1) -> None:
    """Print the head of a table.

    Parameters
    ----------
    words : columns that are aligned to the left; the others hold numbers and are aligned to the right.
    """
    print_row(columns)
    print("|" + "---|" * words + "---:|" * (len(columns) - words))


def print_row(cells: Iterable[str]) -> None:
    """Print a row and flush, so that long runs show progress."""
    print("| " + " | ".join(cells) + " |", flush=True)
