"""The exit codes and what each says to a shell: every place that knows one has it from here."""

from __future__ import annotations

DONE = 0
FAILED = 1
WRONG_USAGE = 2
BAD_INPUT = 3
INTERRUPTED = 130

# As `scanloom --help` says it; the README has the same at length, under "Exit codes".
MEANINGS = {
    DONE: "done",
    FAILED: "a stage failed, or what is written is not what was asked for",
    WRONG_USAGE: "wrong words or configuration",
    BAD_INPUT: "input that cannot be read, or a place that cannot be written",
    INTERRUPTED: "interrupted",
}


def in_short() -> str:
    """Return all of them as one line."""
    return ", ".join(f"{code} {meaning}" for code, meaning in MEANINGS.items())
