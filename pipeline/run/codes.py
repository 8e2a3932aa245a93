"""Diagnostic codes of runs, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

BATCH_LIMIT_EXCEEDED = Code(
    "batch.limit-exceeded",
    "Memory or disk limit exceeded",
    """
Exit code 1, also of `limits.memory` and `limits.disk`. Parameters are never changed automatically: set the
parameter in the message, or increase the limit. Expected use is an estimate until a similar scan was
processed with this cache.
""",
    "fuse has used 900 MB of memory, more than the limit of 600 MB; fuse.voxel_factor=1.5 would fit.",
)
REPORT_NO_RUN = Code(
    "report.no-run",
    "Folder without results of a run",
    """
`coverage` continues a run. It needs the output folder of `scanloom run`, the cache of that run, and the
scan. Give a cache in another folder (`run.cache`) with `--cache`, and a scan that was moved with `--scan`.
""",
    "my_mesh: this folder has no results of a run; give the output folder of `scanloom run`.",
)
