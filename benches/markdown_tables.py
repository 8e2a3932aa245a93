"""Tables in Markdown, a row at a time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def print_head(columns: Sequence[str], words: int = 1) -> None:
    """Print the head of a table; after the first `words` columns there are numbers, which go to the right."""
    print_row(columns)
    print("|" + "---|" * words + "---:|" * (len(columns) - words))


def print_row(cells: Iterable[str]) -> None:
    """Print a row at once, so that a long run can be watched."""
    print("| " + " | ".join(cells) + " |", flush=True)
