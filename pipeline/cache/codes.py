"""Diagnostic codes of the cache, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

MACHINE_CACHE_UNUSABLE = Code(
    "machine.cache-unusable",
    "The cache",
    """
A damaged entry is dropped, and its stage runs again: nothing has to be done, unless it happens often,
which speaks of a
bad disk. A cache that may only be read is used as it is. `scanloom cache verify` looks at all entries,
`scanloom cache prune` removes old ones; deleting the whole folder only costs time.
""",
    ("the cached result of fuse is damaged (fused.ply has 10 bytes instead of 2,045); it is made anew."),
)
