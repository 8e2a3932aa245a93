"""Exit codes."""

from __future__ import annotations

DONE = 0
FAILED = 1
WRONG_USAGE = 2
BAD_INPUT = 3
INTERRUPTED = 130

# As in `scanloom --help`; the README has details under "Exit codes".
MEANINGS = {
    DONE: "done",
    FAILED: "failed or requirement not met",
    WRONG_USAGE: "wrong usage",
    BAD_INPUT: "bad input",
    INTERRUPTED: "interrupted",
}


def summarize() -> str:
    """Return all exit codes in one line."""
    return ", ".join(f"{code} {meaning}" for code, meaning in MEANINGS.items())
