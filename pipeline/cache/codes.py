"""Diagnostic codes of the cache, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

MACHINE_CACHE_UNUSABLE = Code(
    "machine.cache-unusable",
    "Damaged or read-only cache",
    """
A damaged entry is removed and its stage runs again, so nothing has to be done. Repeated damage indicates
a failing disk. A read-only cache is used but not updated. `scanloom cache verify` checks all entries, and
`scanloom cache prune` removes old ones. The whole folder can be deleted safely: stages then run again.
""",
    "the cached result of fuse is damaged (fused.ply has another size); the stage runs again.",
)
