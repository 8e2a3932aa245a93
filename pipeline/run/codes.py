"""Codes of the diagnostics of runs, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

BATCH_LIMIT_EXCEEDED = Code(
    "batch.limit-exceeded",
    "More than a run may take",
    """
Exit code 1, of `run --memory` and `--disk`, too. Nothing is changed without being asked: set what the
sentence names,
or give more. What a stage is expected to take is an estimate until something like it was run with this cache.
""",
    "… … … of memory, more than the limit of …;",
)
